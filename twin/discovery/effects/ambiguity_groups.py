"""Ambiguity groups of a twin's catalogue: effects that no input isolates, found once for each twin.

A simulation excites the twin: all drives step through their ranges, the room drifts, and the tunables are free. After a
quarter of it each candidate begins. Candidates whose whitened signatures agree there to one part in a thousand agree on
every record of the rig: a diagnosis that names one of them has to name the others.
"""

from __future__ import annotations

import contextlib
from dataclasses import asdict, dataclass

import numpy as np

from twin.commissioning import weak_prior
from twin.discovery.cache import store, stored
from twin.discovery.effects.laws import Book
from twin.discovery.effects.probe import Probe
from twin.discovery.records.grid import BIN_S, Grid
from twin.elements.flow import Flow
from twin.network import Array, Network
from twin.steady import steady_state

ALIKE = 0.999
"""Correlation of two signatures from which they form a group: a large effect shows the thousandth between them."""
HOURS, ONSET = 8.0, 0.25
"""Length, h, of the record on which all drives step through their ranges, and share of it at which effects begin."""
REST, AT_REST = (0.45, 0.78), 0.05
"""Part of the run in which heaters rest, and their power then, as shares."""
INLET_K = 20.0
"""Deviation of inlet water from its nominal temperature, K, within the bounds of the twin."""
VISIBLE = 5.0
"""Least score at which an effect is detectable."""
LARGE = 5.0
"""Typical sizes of a large effect; one that shows no score of `VISIBLE` at that size is undetectable."""

EffectLabel = tuple[str, str, str]
"""Kind, place and driver."""


@dataclass(frozen=True)
class AmbiguityGroups:
    """Groups of labels that no input isolates, and labels that are `undetectable` even if the effect is large."""

    groups: tuple[tuple[EffectLabel, ...], ...]
    undetectable: tuple[EffectLabel, ...]

    def indistinguishable_from(self, label: EffectLabel) -> tuple[EffectLabel, ...]:
        """Return the other members of the ambiguity groups of a label."""
        return tuple(dict.fromkeys(x for g in self.groups if label in g for x in g if x != label))


def ambiguity_groups(network: Network) -> AmbiguityGroups:
    """Return the ambiguity groups of a twin's catalogue, from the cache if they were computed before.

    Raises
    ------
    TwinFileError
        The twin has no tunables.
    """
    held = stored("ambiguity_groups", network)
    if held is not None:
        with contextlib.suppress(ValueError, KeyError, TypeError):
            groups = tuple(tuple((k, w, d) for k, w, d in g) for g in held["groups"])
            return AmbiguityGroups(groups, tuple((k, w, d) for k, w, d in held["undetectable"]))
    found = compute_ambiguity_groups(network)
    store("ambiguity_groups", asdict(found), network)
    return found


def compute_ambiguity_groups(network: Network) -> AmbiguityGroups:
    """Compute the ambiguity groups of a twin's catalogue.

    Raises
    ------
    TwinFileError
        The twin has no tunables.
    """
    ids = network.tunables("commission" if "commission" in network.sets else None)
    probe, book = Probe(network, ids), Book(network)
    grid = exciting_inputs(network)
    state = steady_state(network, grid.inputs[0]).reshape(-1)
    grid = Grid(grid.time, grid.inputs, probe.run(grid, state).readings, grid.sigma, grid.step_s)
    run = probe.run(grid, state)
    prior = weak_prior(probe.scaling, network.values[probe.scaling.index], state, 1.0)
    free = (probe.sensitivities(grid, state) / grid.sigma[:, None]).reshape(-1, probe.q + probe.k)
    laws = book.laws(grid, run)
    on = (grid.time >= ONSET * grid.time[-1])[:, None]
    shown = np.empty((free.shape[0], len(laws)))
    for i, law in enumerate(laws):
        change = np.zeros_like(run.readings) if law.reading is None else law.reading * on
        if law.heat is not None:
            change = change + probe.run(grid, state, injected=law.heat * on).readings - run.readings
        shown[:, i] = (change / grid.sigma).ravel()
    cross = free.T @ shown
    gram = shown.T @ shown - cross.T @ np.linalg.solve(free.T @ free + prior.precision, cross)
    norm = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    labels = [(law.candidate.kind, law.candidate.where, law.candidate.driver) for law in laws]
    visible = [n * LARGE * law.candidate.typical > VISIBLE for n, law in zip(norm, laws, strict=True)]
    groups: list[list[int]] = []
    for i in np.argsort(-norm * [law.candidate.typical for law in laws]).tolist():
        if not visible[i]:
            continue
        for group in groups:
            if abs(gram[i, group[0]]) > ALIKE * norm[i] * norm[group[0]]:
                group.append(i)
                break
        else:
            groups.append([i])
    named = [tuple(dict.fromkeys(labels[i] for i in sorted(g))) for g in groups]
    seen = {labels[i] for i in range(len(laws)) if visible[i]}
    every = dict.fromkeys((c.kind, c.where, c.driver) for c in book.candidates)
    return AmbiguityGroups(tuple(g for g in named if len(g) > 1), tuple(x for x in every if x not in seen))


def exciting_inputs(network: Network, seed: int = 0) -> Grid:
    """Return inputs that excite a network persistently, each column independent of the others.

    Drives and inlet temperatures step every 5 to 40 minutes, the room drifts slowly. The heater rests for a third of
    the time, so that the slowest volume cools and warms again.
    """
    rng = np.random.default_rng(seed)
    bins = int(HOURS * 3600.0 / BIN_S)
    time: Array = BIN_S * np.arange(bins, dtype=np.float64)
    inputs = np.empty((bins, len(network.input_columns)))
    inlets = {e.inlet for e in network.elements if isinstance(e, Flow)}
    for j, (column, spec) in enumerate(network.inputs.items()):
        if column.startswith("time_of_day"):
            inputs[:, j] = (4.0 * time / 3600.0) % 24.0
        elif column in inlets:
            low, high = max(spec.lower, spec.nominal - INLET_K), min(spec.upper, spec.nominal + INLET_K)
            inputs[:, j] = _stepped(rng, time, low, high)
        elif column.endswith("_C"):
            inputs[:, j] = spec.nominal + 4.0 * np.sin(2.0 * np.pi * time / (2.3 * 3600.0)) + 2.0 * time / time[-1]
        else:
            high = min(spec.upper, 1.3 * spec.nominal) if spec.nominal > 0.0 else spec.upper
            low = max(spec.lower, 0.3 * spec.nominal)
            inputs[:, j] = _stepped(rng, time, low, high)
            if column.endswith("_W"):
                inputs[(time > REST[0] * time[-1]) & (time < REST[1] * time[-1]), j] *= AT_REST
    return Grid(time, inputs, np.full((bins, len(network.sensors)), np.nan), network.sigma, BIN_S)


def _stepped(rng: np.random.Generator, time: Array, low: float, high: float) -> Array:
    edges = np.cumsum(rng.uniform(300.0, 2400.0, int(time[-1] / 300.0) + 2))
    levels = rng.uniform(low, high, len(edges) + 1)
    stepped: Array = levels[np.searchsorted(edges, time, side="right")]
    return stepped
