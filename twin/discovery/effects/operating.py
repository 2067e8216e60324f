"""Offsets at operating points: model error of power laws at each pair of fan and pump speeds.

A twin's radiator follows fan and pump by two power laws, a rig's by films, fins and air; a pump is not exactly
proportional to its speed. At any one pair of speeds such a law has a constant error of a few per cent, which looks like
an effect since the speeds were last set. The structure therefore has an offset at each operating point. A healthy
record estimates the offsets of the points that it visited, and the prior spread of all others.
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
"""Tolerance, %, within which speeds are the same."""
MOST = 32
"""Operating points at most, those with the longest total time."""


def offsets(network: Network, laws: list[CandidateLaw], grid: Grid) -> list[CandidateLaw]:
    """Return laws of offsets: heat rejection at each pair of fan and pump speeds, and flow at each pump speed."""
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
    """Return a law restricted to each operating point."""
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
