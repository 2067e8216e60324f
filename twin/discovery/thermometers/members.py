"""Differences between the thermometers whose mean is one sensor, less those in health.

In a healthy rig the differences between thermometers in a row follow from the heat that the water gives off on its way,
and from the heat that is released there. They are learned from a healthy record.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twin.discovery.effects.shapes import Shape
from twin.discovery.records.grid import Grid
from twin.first_order_lag import lagged
from twin.network import Array, Network

LEAST_MEMBERS = 3
"""Thermometers of a sensor that are compared: of two that differ, either may be right."""
LATE_WINDOW_S, RATE_S, LEAST_RATE = 7200.0, 60.0, 1.5e-4
"""Windows for the estimation of lags, s; time over which rates are taken, s, whose noise would bias a lag low; and
least scatter of rates in a window, K/s."""
PRESENT = 0.7
"""Share of a sensor's bins with a reading that a thermometer needs for comparison with the others."""
MARGIN_K = 0.06
"""Deviations below this, K, are ignored: contact and placement shift by as much."""
STANDS_OUT = 6.0
"""Deviation of one thermometer, in healthy standard deviations of a block, from which it is significant."""
RELEASED_S = (0.0, *(30.0 * 2.0**k for k in range(8)))
"""Lags, s, behind what heat in a row follows, of which the healthy record tells the likeliest: up to about an hour."""
NEAR_S = 10800.0
"""Time before and after an onset, s, in which the change of differences is estimated."""


@dataclass(frozen=True)
class Members:
    """Differences between the thermometers of one sensor.

    Attributes:
        columns: in flow direction. residual: (b, c) K, of block means, less the healthy differences. sd: (c,) K.
        edges_s: (b + 1,) s from the record's beginning. most: K, largest deviation in a healthy block: a warm front
            that passes the row causes transient differences.
        fine: (n, c) K, the same as `residual` for bins of `step_s`. mean: (n,) degC, of the available thermometers.
        late_s: (w, c) s, lag of each behind the others in windows of the healthy record.
        follows: driver -> (b,), what differences may be proportional to, in blocks.
        row: (d, c), directions in which differences vary in health: those of the row as a whole.
    """

    sensor: str
    columns: tuple[str, ...]
    residual: Array
    sd: Array
    edges_s: Array
    most: float = 0.0
    fine: Array = field(default_factory=lambda: np.empty((0, 0)), repr=False)
    mean: Array = field(default_factory=lambda: np.empty(0), repr=False)
    step_s: float = 0.0
    late_s: Array = field(default_factory=lambda: np.empty((0, 0)), repr=False)
    follows: dict[str, Array] = field(default_factory=dict, repr=False)
    row: Array = field(default_factory=lambda: np.empty((0, 0)), repr=False)

    @property
    def good(self) -> np.ndarray:
        """Return the blocks in which every thermometer has a reading."""
        return np.flatnonzero(np.isfinite(self.residual).all(axis=1))

    def by_itself(self, i: int, residual: Array) -> Array:
        """Return the error of member i alone, K, in each row of differences (r, c)."""
        weight = pattern_of(i, residual.shape[1]) / self.sd
        off: Array = (residual / self.sd) @ weight / (weight @ weight)
        return off

    def without(self, column: str) -> Members:
        """Return the group without one member."""
        keep = [i for i, c in enumerate(self.columns) if c != column]

        def rest(values: Array) -> Array:
            kept = values[:, keep] if len(values) else values
            return kept - kept.mean(axis=1, keepdims=True)

        return replace(
            self,
            columns=tuple(self.columns[i] for i in keep),
            residual=rest(self.residual),
            sd=self.sd[keep],
            fine=rest(self.fine),
            late_s=rest(self.late_s),
            row=rest(self.row),
        )

    def less(self, column: str, size: float, shape: Shape) -> Members:
        """Return the group without an effect of `size` K at one column."""
        pattern: Array = size * pattern_of(self.columns.index(column), len(self.columns))
        bins_s: Array = np.arange(len(self.fine) + 1.0) * self.step_s
        return replace(
            self,
            residual=self.residual - shape.block_means(self.edges_s)[:, None] * pattern,
            fine=self.fine - shape.block_means(bins_s)[:, None] * pattern if len(self.fine) else self.fine,
        )

    def around(self, moment_s: float) -> Members:
        """Return the group within some hours of a time, relative to its differences before."""
        before = (self.edges_s[1:] <= moment_s) & (self.edges_s[1:] > moment_s - NEAR_S)
        near = (self.edges_s[:-1] > moment_s - NEAR_S) & (self.edges_s[:-1] < moment_s + NEAR_S)
        known = self.residual[before & np.isfinite(self.residual).all(axis=1)]
        usual = known.mean(axis=0) if len(known) else np.full(len(self.columns), np.nan)
        return replace(self, residual=np.where(near[:, None], self.residual - usual, np.nan))


def members(
    network: Network,
    record: dict[str, Array],
    grid: Grid,
    healthy: dict[str, Array],
    healthy_grid: Grid,
    edges: np.ndarray,
) -> tuple[Members, ...]:
    """Return the differences within every sensor with at least three thermometers.

    Args:
        record, healthy: sensor -> means on the grid's bins (n, c), degC, NaN where missing.
        edges: (b + 1,) bins of the record's blocks.
    """
    found = []
    for sensor in network.sensors:
        if sensor.name not in record or sensor.name not in healthy:
            continue
        # One that is not there most of the time is not compared; the others are, with each other.
        there = _present(record[sensor.name]) & _present(healthy[sensor.name])
        if there.sum() < LEAST_MEMBERS:
            continue
        bins = int(np.diff(edges).mean().round())
        healthy_edges = np.arange(0, len(healthy_grid.time) + 1, bins)
        known = _blocks(healthy[sensor.name][:, there], healthy_edges)
        law = _learned(network, sensor.node, healthy_grid, *known, healthy_edges)
        if law is None:
            continue
        usual = law.differences(healthy_grid, known[0], healthy_edges)
        good = np.isfinite(usual).all(axis=1) & np.isfinite(known[1]).all(axis=1)
        left = known[1][good] - usual[good]
        scatter = left.std(axis=0)
        mean, difference = _blocks(record[sensor.name][:, there], edges)
        residual = difference - law.differences(grid, mean, edges)
        sd = np.maximum(scatter, MARGIN_K / STANDS_OUT)
        columns = tuple(c for c, t in zip(sensor.measured, there, strict=True) if t)
        bin_mean, fine = _finely(law, grid, record[sensor.name][:, there])
        in_health = lateness(*_finely(law, healthy_grid, healthy[sensor.name][:, there]), healthy_grid.step_s)
        here = Members(
            sensor.name,
            columns,
            residual,
            sd,
            edges * grid.step_s,
            fine=fine,
            mean=bin_mean,
            step_s=grid.step_s,
            late_s=in_health,
            follows=_follows(network, grid, mean, edges),
            row=_row(usual[good]),
        )
        most = max(float(np.abs(here.by_itself(i, left)).max()) for i in range(left.shape[1]))
        found.append(replace(here, most=most))
    return tuple(found)


def _present(values: Array) -> np.ndarray:
    """Return a mask (c,) of thermometers (n, c) with a reading in most bins in which any has one."""
    good = np.isfinite(values)
    present: np.ndarray = good.mean(axis=0) > PRESENT * good.any(axis=1).mean()
    return present


def _blocks(values: Array, edges: np.ndarray) -> tuple[Array, Array]:
    """Return block means of the mean thermometer (b,), and of each one's difference from it (b, c)."""
    good = np.isfinite(values)
    count = np.add.reduceat(good, edges[:-1], axis=0)[: len(edges) - 1]
    total = np.add.reduceat(np.where(good, values, 0.0), edges[:-1], axis=0)[: len(edges) - 1]
    each = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    present = np.isfinite(each)
    number = np.maximum(present.sum(axis=1), 1)
    mean = np.where(present.any(axis=1), np.where(present, each, 0.0).sum(axis=1) / number, np.nan)
    return mean, each - mean[:, None]


@dataclass(frozen=True)
class HealthyDifferences:
    """Law of the differences in a row.

    It has `weights` (p, c) of an offset, of the excess over the room, alone and over the flow, and of the inputs
    `released` that heat there follows. These are taken less their means `usual` in health, and `late_s` late. A unit of
    each makes the row `warmer` (d,) by so many K at rest. That tells how much of it a record's beginning remembers.
    """

    network: Network
    released: tuple[int, ...]
    usual: Array
    warmer: Array
    late_s: float
    weights: Array

    def differences(self, grid: Grid, mean: Array, edges: np.ndarray) -> Array:
        """Return the healthy differences (b, c), K, of blocks with the mean thermometer (b,)."""
        found: Array = self.regressors(grid, mean, edges) @ self.weights
        return found

    def regressors(self, grid: Grid, mean: Array, edges: np.ndarray) -> Array:
        """Return the regressors (b, p) of blocks."""
        columns, length = list(self.network.input_columns), np.diff(edges)[:, None]
        rows = np.add.reduceat(grid.inputs, edges[:-1], axis=0)[: len(edges) - 1] / length
        excess = mean - (rows[:, columns.index(self.network.room)] if self.network.room else 0.0)
        given_off = grid.inputs[:, list(self.released)]
        if self.late_s > 0.0:
            at_rest, warm = float(given_off[0] @ self.warmer), float(next(iter(excess[np.isfinite(excess)]), np.inf))
            known = min(max(warm / at_rest, 0.0), 1.0) if at_rest > 0.0 else 1.0
            keep = float(np.exp(-grid.step_s / self.late_s))
            before = np.vstack([known * given_off[:1], given_off])
            given_off = np.column_stack([lagged(each.copy(), keep)[1:] for each in before.T])
        own = np.add.reduceat(given_off - self.usual, edges[:-1], axis=0)[: len(edges) - 1] / length
        pump = next((rows[:, j] for j, c in enumerate(columns) if c.startswith("pump")), np.full(len(rows), 100.0))
        return np.column_stack([np.ones(len(rows)), excess, excess * 100.0 / np.maximum(pump, 5.0), own])


def _learned(
    network: Network, node: str, grid: Grid, mean: Array, difference: Array, edges: np.ndarray
) -> HealthyDifferences | None:
    """Return the law of a healthy row, with the lag that fits best; None if the record has too few blocks."""
    named = {column for e in network.elements if e.kind == "heat_source" and node in e.nodes() for column in e.inputs()}
    released = tuple(j for j, column in enumerate(network.input_columns) if column in named)
    usual, nothing = grid.inputs[:, list(released)].mean(axis=0), np.zeros(len(released))
    unit = HealthyDifferences(network, released, nothing, nothing, 0.0, np.empty(0)).regressors(grid, mean, edges)
    known = np.isfinite(unit).all(axis=1)
    if known.sum() < 3 * unit.shape[1]:
        return None
    warmer = np.linalg.lstsq(unit[known][:, 3:], unit[known][:, 1], rcond=None)[0].astype(np.float64)
    best: tuple[float, HealthyDifferences] | None = None
    for late_s in RELEASED_S if released else RELEASED_S[:1]:
        law = HealthyDifferences(network, released, usual, warmer, late_s, np.empty(0))
        given = law.regressors(grid, mean, edges)
        good = np.isfinite(given).all(axis=1) & np.isfinite(difference).all(axis=1)
        if good.sum() < 3 * given.shape[1]:
            return None
        weights: Array = np.linalg.lstsq(given[good], difference[good], rcond=None)[0].astype(np.float64)
        left = float(((difference[good] - given[good] @ weights) ** 2).sum())
        if best is None or left < best[0]:
            best = left, replace(law, weights=weights)
    return None if best is None else best[1]


def _row(differences: Array) -> Array:
    """Return the directions (d, c) in which the differences (b, c) of a healthy row vary by more than `MARGIN_K`."""
    _, spread, directions = np.linalg.svd(differences - differences.mean(axis=0), full_matrices=False)
    found: Array = directions[spread > MARGIN_K * np.sqrt(len(differences))]
    return found


def _finely(law: HealthyDifferences, grid: Grid, values: Array) -> tuple[Array, Array]:
    """Return for every bin the mean of thermometers (n, c) and their differences from it, less the healthy ones."""
    every = np.arange(len(grid.time) + 1)
    mean, difference = _blocks(values, every)
    return mean, difference - law.differences(grid, mean, every)


def lateness(mean: Array, difference: Array, step_s: float) -> Array:
    """Return the lag, s, of each of several thermometers behind their mean (n,) in windows (w, c); NaN without
    variation.

    A lagging thermometer differs (n, c) by minus its lag times the rate of the mean, as long as that rate varies slowly
    compared with the lag.
    """
    joined = max(round(RATE_S / step_s), 1)
    rows = len(mean) // joined
    mean = mean[: rows * joined].reshape(rows, joined).mean(axis=1)
    difference = difference[: rows * joined].reshape(rows, joined, -1).mean(axis=1)
    rate = -np.gradient(mean, joined * step_s) if rows > 1 else np.full(rows, np.nan)
    per = max(round(LATE_WINDOW_S / (joined * step_s)), 1)
    found = np.full((rows // per, difference.shape[1]), np.nan)
    for w in range(len(found)):
        part = slice(w * per, (w + 1) * per)
        known = np.isfinite(rate[part]) & np.isfinite(difference[part]).all(axis=1)
        if known.sum() < 0.5 * per:
            continue
        x = rate[part][known] - rate[part][known].mean()
        spread = float(x @ x)
        if spread > known.sum() * LEAST_RATE**2:
            found[w] = (x @ difference[part][known]) / spread / pattern_of(0, difference.shape[1])[0]
    return found


def _follows(network: Network, grid: Grid, mean: Array, edges: np.ndarray) -> dict[str, Array]:
    """Return the drivers of a place in blocks: its excess over the room, and the heater's power."""
    rows = np.add.reduceat(grid.inputs, edges[:-1], axis=0)[: len(edges) - 1] / np.diff(edges)[:, None]
    columns = dict(zip(network.input_columns, rows.T, strict=True))
    room = columns.get(network.room)
    power = next((values for name, values in columns.items() if name.startswith("heater_power")), None)
    found = {"temperature": mean}
    if room is not None:
        found["temperature_difference"] = mean - room
    if power is not None:
        found["heater_power"] = power
    return found


def pattern_of(i: int, number: int) -> Array:
    """Return the differences from the mean, its own and the others', if one of so many thermometers is off by 1 K."""
    return np.where(np.arange(number) == i, 1.0 - 1.0 / number, -1.0 / number)
