"""The experiment that would tell two causes apart: load, pump and fan in an order that the rig can run.

A small library of ten-hour sequences within the limits of the twin's inputs and of the temperatures that the rig has
seen; the one with the largest expected difference between the causes is proposed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twin.discovery.forecast import from_the_start, separation
from twin.discovery.grid import Grid
from twin.discovery.laws import Book
from twin.discovery.noise import Noise
from twin.discovery.probe import Probe
from twin.discovery.search import Entry
from twin.gauss_newton import Prior
from twin.network import Array

HOURS = 8.0
ABOVE_K = 3.0
"""How much hotter than the hottest reading so far a planned experiment may become."""
ENOUGH = 30.0
"""Expected difference in weighted squares that settles the matter."""


@dataclass(frozen=True)
class Experiment:
    """`steps`: (start s, {input column: value}); `difference`: expected, in weighted squares; `why` in words."""

    name: str
    steps: tuple[tuple[float, Mapping[str, float]], ...]
    difference: float
    hottest_C: float
    why: str


def propose(
    probe: Probe, book: Book, noise: Noise, prior: Prior, grid: Grid, entries: tuple[Entry, ...], seed: int = 0
) -> Experiment | None:
    """The best sequence of the library for telling the entries apart; None where no sequence does.

    Args:
        grid: the record so far; its last readings are where the experiment begins, its hottest ones the limit.
        entries: hypotheses with their sizes as they are now.
    """
    network = probe.network
    state = probe.network.initial_state(grid.measured[-30:])
    limit = float(np.nanmax(grid.measured)) + ABOVE_K
    now = tuple(from_the_start(e, e.size * e.shape.mean(grid.span_s - 1.0, grid.span_s)) for e in entries)
    bins = int(HOURS * 3600.0 / grid.step_s)
    best: Experiment | None = None
    for name, steps in _library(network.input_columns, grid, seed).items():
        inputs: Array = np.empty((bins, len(network.input_columns)))
        inputs[:] = np.median(grid.inputs, axis=0)
        time: Array = np.arange(bins, dtype=np.float64) * grid.step_s
        for start, values in steps:
            for column, value in values.items():
                inputs[time >= start, network.input_columns.index(column)] = value
        plan = Grid(time, inputs, np.full((bins, probe.m), np.nan), grid.sigma, grid.step_s)
        hottest = float(probe.run(plan, state).readings.max())
        if hottest > limit:
            continue
        difference = separation(probe, book, noise, prior, plan, now, state)
        if best is None or difference > best.difference:
            why = f"expected difference {difference:.0f} in weighted squares, hottest reading {hottest:.0f} degC"
            best = Experiment(name, tuple(steps), difference, hottest, why)
    return best if best is not None and best.difference >= ENOUGH else None


def _library(columns: tuple[str, ...], grid: Grid, seed: int) -> dict[str, list[tuple[float, dict[str, float]]]]:
    """Named sequences of half-hour to two-hour steps over heater, pump and fan."""
    driven: dict[str, tuple[float, float, float]] = {}
    for j, column in enumerate(columns):
        if column.startswith(("heater", "pump", "fan")):
            low, high = float(np.min(grid.inputs[:, j])), float(np.max(grid.inputs[:, j]))
            if column.startswith("heater"):
                driven[column] = (0.0, 0.5 * high, high)
            else:
                floor = max(low, 30.0)
                driven[column] = (floor, max(0.5 * (floor + high), floor), max(high, 100.0 if high > 90.0 else high))
                if high - low < 5.0:
                    driven[column] = (max(0.5 * high, 30.0), max(0.75 * high, 30.0), high)
    if not driven:
        return {}
    rng = np.random.default_rng(seed)
    middle = {c: v[1] for c, v in driven.items()}
    top = {c: v[2] for c, v in driven.items()}
    out: dict[str, list[tuple[float, dict[str, float]]]] = {}
    for column in driven:
        levels = (2, 0, 2, 1, 0, 2, 0, 1)
        rest = {c: v for c, v in middle.items() if c != column}
        name = column.rsplit("_", 1)[0]
        out[f"{name} steps"] = [(3600.0 * i, {**rest, column: driven[column][k]}) for i, k in enumerate(levels)]
    both = [(1800.0 * i, {c: driven[c][int(rng.integers(0, 3))] for c in driven}) for i in range(int(2.0 * HOURS))]
    out["steps of everything"] = both
    heater = next((c for c in driven if c.startswith("heater")), "")
    if heater:
        out["heat, then rest"] = [(0.0, {**top}), (3.0 * 3600.0, {**top, heater: 0.0})]
        out["rest, then heat"] = [(0.0, {**top, heater: 0.0}), (4.0 * 3600.0, {**top})]
        fast = [(600.0 * i, {**middle, heater: driven[heater][2 * int(rng.integers(0, 2))]}) for i in range(48)]
        out["heater in short pulses"] = fast
        slow_fan = {c: driven[c][0] for c in driven if c != heater}
        out["rest at low flow, then heat"] = [
            (0.0, {**slow_fan, heater: 0.0}), (2.5 * 3600.0, {**slow_fan, heater: driven[heater][1]}),
            (5.0 * 3600.0, {**top}),
        ]  # fmt: skip
    return out
