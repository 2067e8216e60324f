"""Operating points: heat that a law of powers hides at each pair of speeds.

A radiator follows fan and pump by two powers in a twin, and by films, fins and air in a rig; a pump is not quite in
proportion to its speed. At any one pair of speeds such a law is off by a few per cent, and by the same for as long as
they stay: what looks like an effect since the speeds were last set. So structure knows of such offsets, one at each
point at which the rig works. What a healthy record visited is known from it; of any other point it tells how large
offsets are there, which is what they may be here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.records.grid import Grid
from twin.elements.flow import Flow
from twin.elements.radiator import Radiator
from twin.network import Network

WIDTH = 5.0
"""Speeds within so much of one another, %, are one."""
MOST = 32
"""Points that are told apart, those at which the rig stays longest."""


def offsets(network: Network, laws: list[CandidateLaw], grid: Grid) -> list[CandidateLaw]:
    """Heat rejection at each pair of fan and pump speeds, and flow at each pump speed, of laws of one record."""
    speeds: dict[str, tuple[str, ...]] = {}
    for element in network.elements:
        if isinstance(element, Radiator):
            speeds[f"{element.name}.UA_100"] = (element.fan, element.pump)
        elif isinstance(element, Flow):
            speeds[f"{element.name}.factor"] = (element.pump,)
    found = []
    for law in laws:
        (name, *others) = law.candidate.changes
        if not others and law.heat is not None and not law.candidate.adds and name in speeds:
            found += _each(law, grid, [(c, network.input_columns.index(c)) for c in dict.fromkeys(speeds[name])])
    return found


def _each(law: CandidateLaw, grid: Grid, columns: list[tuple[str, int]]) -> list[CandidateLaw]:
    """A law at each point by itself."""
    assert law.heat is not None
    (name,) = law.candidate.changes
    points = np.rint(grid.inputs[:, [j for _, j in columns]] / WIDTH).astype(np.int64)
    levels, which, stays = np.unique(points, axis=0, return_inverse=True, return_counts=True)
    found = []
    for p in np.argsort(-stays)[:MOST]:
        at = " and ".join(f"{c} {WIDTH * level:.0f}" for (c, _), level in zip(columns, levels[p], strict=True))
        own = replace(law.candidate, changes={f"{name} at {at}": 1.0}, says=f"{law.candidate.says} at {at}", near=None)
        found.append(CandidateLaw(own, law.heat * (which.ravel() == p)[:, None], None))
    return found
