"""Differences between the thermometers whose mean is one sensor, and detection of the one that deviates.

In a healthy rig the differences between thermometers in a row follow from the heat that the water gives off on its way.
They are learned from a healthy record; a later deviation belongs to one thermometer, to one of their places, or to all
alike.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twin.discovery.effects.shapes import Shape, courses_of, family
from twin.discovery.records.grid import Grid
from twin.discovery.scoring.equivalence import width
from twin.first_order_lag import lagged
from twin.network import Array, Network
from twin.quantiles import NORMAL90

LEAST_MEMBERS = 3
LATE_WINDOW_S, RATE_S, LEAST_RATE = 7200.0, 60.0, 1.5e-4
"""Windows for the estimation of lags, s; time over which rates are taken, s, whose noise would bias a lag low; and
least scatter of rates in a window, K/s."""
PRESENT = 0.7
"""Share of a sensor's bins with a reading that a thermometer needs for comparison with the others."""
MARGIN_K = 0.06
"""Deviations below this, K, are ignored: contact and placement shift by as much."""
STANDS_OUT = 6.0
"""Deviation of one thermometer, in healthy standard deviations of a block, from which it is significant."""
LATE_WINDOWS, LEAST_LAG_S, ALONE, NEARLY = 3, 25.0, 0.4, 0.8
"""Windows that a lag must persist for; least lag, s; share of it that any other, or itself before, may have; and share
of the best onset's gain that the earliest onset must reach."""
LAG_SHARE = 0.5
"""Share of a deviation from minute to minute that a lag has to explain; an intermittent fault resembles one."""
LAGS_S = tuple(20.0 * 1.08**k for k in range(45))
"""Time constants that are tried, s."""
SHARE = 0.7
"""Share of the differences that one member must have to be isolated."""
CORRELATED = 6.0
"""Correlation time of differences between thermometers in a row, in blocks."""
OFTEN = 3
"""Blocks in which one member must deviate alone to have an intermittent fault (decision 0021)."""


NEAR_S = 10800.0
"""Time before and after an onset, s, in which the change of differences is estimated."""
LEAST_OF = 0.2
"""Ratio of two deviating members' deviations from which both count: heat at a place warms its neighbours a little."""


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

    @property
    def good(self) -> np.ndarray:
        """Return the blocks in which every thermometer has a reading."""
        return np.flatnonzero(np.isfinite(self.residual).all(axis=1))

    def by_itself(self, i: int, residual: Array) -> Array:
        """Return the error of member i alone, K, in each row of differences (r, c)."""
        weight = _pattern(i, residual.shape[1]) / self.sd
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
        )

    def less(self, column: str, size: float, shape: Shape) -> Members:
        """Return the group without an effect of `size` K at one column."""
        pattern: Array = size * _pattern(self.columns.index(column), len(self.columns))
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


@dataclass(frozen=True)
class Odd:
    """Deviating member: `column`, by `size` K times its `shape`, `final` K at its last reading, with `share` of all
    differences.
    """

    column: str
    size: float
    sd: float
    shape: Shape
    share: float
    z: float
    final: float

    @property
    def place(self) -> str:
        """Return the place of the thermometer."""
        return place_of(self.column)


def place_of(column: str) -> str:
    """Return the place of a thermometer by the name of its column."""
    return column.removeprefix("T_").removesuffix("_C")


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
        known = _blocks(healthy[sensor.name][:, there], np.arange(0, len(healthy_grid.time) + 1, bins))
        basis = _basis(network, healthy_grid, known[0], np.arange(0, len(healthy_grid.time) + 1, bins))
        good = np.isfinite(basis).all(axis=1) & np.isfinite(known[1]).all(axis=1)
        if good.sum() < 3 * basis.shape[1]:
            continue
        law, *_ = np.linalg.lstsq(basis[good], known[1][good], rcond=None)
        left = known[1][good] - basis[good] @ law
        scatter = left.std(axis=0)
        mean, difference = _blocks(record[sensor.name][:, there], edges)
        residual = difference - _basis(network, grid, mean, edges) @ law
        sd = np.maximum(scatter, MARGIN_K / STANDS_OUT)
        columns = tuple(c for c, t in zip(sensor.measured, there, strict=True) if t)
        bin_mean, fine = _finely(network, grid, record[sensor.name][:, there], law)
        in_health = lateness(*_finely(network, healthy_grid, healthy[sensor.name][:, there], law), healthy_grid.step_s)
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


def _basis(network: Network, grid: Grid, mean: Array, edges: np.ndarray) -> Array:
    """Return the regressors of healthy differences: offset, and excess over the room, alone and over the flow."""
    rows = np.add.reduceat(grid.inputs, edges[:-1], axis=0)[: len(edges) - 1] / np.diff(edges)[:, None]
    columns = list(network.input_columns)
    room = rows[:, columns.index(network.room)] if network.room else np.zeros(len(rows))
    pump = next((rows[:, j] for j, c in enumerate(columns) if c.startswith("pump")), np.full(len(rows), 100.0))
    excess = mean - room
    return np.column_stack([np.ones(len(rows)), excess, excess * 100.0 / np.maximum(pump, 5.0)])


def _finely(network: Network, grid: Grid, values: Array, law: NDArray[np.floating]) -> tuple[Array, Array]:
    """Return for every bin the mean of thermometers (n, c) and their differences from it, less the healthy ones."""
    every = np.arange(len(grid.time) + 1)
    mean, difference = _blocks(values, every)
    return mean, difference - _basis(network, grid, mean, every) @ law


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
            found[w] = (x @ difference[part][known]) / spread / _pattern(0, difference.shape[1])[0]
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


def odd_one(found: Members, shapes: tuple[Shape, ...] = ()) -> Odd | None:
    """Return the deviating member, or None.

    Args:
        shapes: time courses that are tried. By default steps at every other block and drifts, a drift only if it is
            significantly better than any step.
    """
    good = found.good
    if len(good) < 6:
        return None
    best = _oddest(found, good, shapes or _steps(found))
    drift = None if shapes else _oddest(found, good, _drifts(found))
    if drift is not None and (best is None or drift.z**2 > best.z**2 + width(best.z**2)):
        best = drift
    if best is None or best.share < SHARE:
        return None
    stands_out = abs(best.final) * (1.0 - 1.0 / len(found.columns)) / found.sd[found.columns.index(best.column)]
    return best if stands_out >= STANDS_OUT else None


def apart(found: Members) -> tuple[Members, ...]:
    """Return the group without each of two deviating members in turn; the whole group if there are not two."""
    if len(found.columns) <= LEAST_MEMBERS:
        return (found,)
    whole = odd_one(found)
    pairs = []
    for column in found.columns if whole is None else (whole.column,):
        second = odd_one(found.without(column))
        first = None if second is None else odd_one(found.without(second.column))
        if first is None or second is None or first.column != column:
            continue
        small, large = sorted((abs(first.final), abs(second.final)))
        if small > LEAST_OF * large:
            pairs.append((min(first.z, second.z), first.column, second.column))
    if not pairs:
        return (found,)
    _, one, other = max(pairs)
    return found.without(other), found.without(one)


def _steps(found: Members) -> tuple[Shape, ...]:
    last = max(int(len(found.residual) * 0.95), 1)
    return tuple(Shape("step", float(t)) for t in found.edges_s[:last:2])


def _drifts(found: Members) -> tuple[Shape, ...]:
    end_s = float(found.edges_s[-1])
    onsets = found.edges_s[: max(int(len(found.residual) * 0.85), 1) : 4]
    return tuple(Shape("ramp", float(t), g).going_on(end_s) for t in onsets for g in family("ramp", end_s))


def _oddest(found: Members, good: np.ndarray, shapes: tuple[Shape, ...]) -> Odd | None:
    """Return the member, with one of these shapes, that explains most of the squares of `good` blocks."""
    number = len(found.columns)
    courses = courses_of(shapes, found.edges_s)[:, good]
    power = (courses**2).sum(axis=1)
    kept = np.flatnonzero(power > 3.0 * courses.max(axis=1, initial=0.0) ** 2)
    if not len(kept):
        return None
    power = power[kept]
    amplitudes = courses[kept] @ found.residual[good] / power[:, None] / found.sd
    weights = np.stack([_pattern(i, number) for i in range(number)]) / found.sd
    squares = (weights**2).sum(axis=1)
    sizes = amplitudes @ weights.T / squares
    carried = sizes**2 * squares
    gains = carried * power[:, None]
    k, i = np.unravel_index(np.argmax(gains), gains.shape)
    shape, size = shapes[kept[k]], float(sizes[k, i])
    sd = float(found.sd[i]) / np.sqrt(max(float(power[k]) / CORRELATED, 1.0))
    last_s = float(found.edges_s[good[-1] + 1])
    share = float(carried[k, i]) / max(float((amplitudes[k] ** 2).sum()), 1e-12)
    final = size * shape.mean(last_s - 1.0, last_s)
    return Odd(found.columns[i], size, sd, shape, share, float(np.sqrt(gains[k, i])), final)


def began_between(found: Members, odd: Odd) -> tuple[float, float]:
    """Return the 90 % interval, s from the record's beginning, of the onset of a member's deviation."""
    good = found.good
    i, edges, end_s = found.columns.index(odd.column), found.edges_s, float(found.edges_s[-1])
    off = found.by_itself(i, found.residual[good])

    def gain(onset_s: float) -> float:
        shapes = [replace(odd.shape, onset_s=onset_s)]
        if odd.shape.name == "ramp":
            ended_s = odd.shape.onset_s + odd.shape.growth_s
            shapes += [Shape("ramp", onset_s, g) for g in (ended_s - onset_s, *family("ramp", end_s)) if g > 0.0]
        courses = [shape.block_means(edges)[good] for shape in shapes]
        return max(float(c @ off) ** 2 / max(float(c @ c), 1e-12) for c in courses)

    onsets = np.append(edges[: max(int(0.95 * len(found.residual)), 1)], odd.shape.onset_s)
    gains = np.array([gain(float(t)) for t in onsets])
    weight = _pattern(i, len(found.columns)) / found.sd
    able = onsets[gains >= gains.max() - CORRELATED * NORMAL90**2 / float(weight @ weight)]
    block = float(edges[1] - edges[0])
    return max(float(able.min()) - block, 0.0), min(float(able.max()) + block, end_s)


def restless_one(found: Members) -> Odd | None:
    """Return the member with an intermittent fault, which is right on average as with a loose contact; None if there is
    none.

    Its `size` is its largest deviation in a block, its `shape` begins with the first of these blocks, its `share` is
    theirs of all blocks.
    """
    good = np.isfinite(found.residual).all(axis=1)
    residual, number = found.residual[good] / found.sd, found.residual.shape[1]
    total = (residual**2).sum(axis=1)
    best: Odd | None = None
    for i in range(number):
        weight = _pattern(i, number) / found.sd
        size = found.by_itself(i, found.residual[good])
        stands_out = np.abs(size) > max(STANDS_OUT * found.sd[i] / (1.0 - 1.0 / number), found.most)
        off = stands_out & (size**2 * (weight @ weight) > SHARE * total)
        if off.sum() < OFTEN or (best is not None and off.mean() < best.share):
            continue
        most, first = float(np.abs(size[off]).max()), float(found.edges_s[:-1][good][off][0])
        score = float(np.sqrt((size[off] ** 2).sum() * (weight @ weight)))
        shape = Shape("step", first)
        best = Odd(found.columns[i], most, float(found.sd[i]), shape, float(off.mean()), score, most)
    return best


def _pattern(i: int, number: int) -> Array:
    """Return the differences from the mean, its own and the others', if one of so many thermometers is off by 1 K."""
    return np.where(np.arange(number) == i, 1.0 - 1.0 / number, -1.0 / number)


def lagging_one(found: Members) -> Odd | None:
    """Return the member that lags from some onset on, as one that has come loose does; None if there is none.

    Its `size` and `final` are the time constant, s, its `sd` is of it.
    """
    late = lateness(found.mean, found.fine, found.step_s)
    known = np.flatnonzero(np.isfinite(late).all(axis=1))
    if len(known) < LATE_WINDOWS or not np.isfinite(found.late_s).any():
        return None
    late = late[known] - np.nanmedian(found.late_s, axis=0)
    i = int(np.argmax(np.median(late[-(len(late) // 2) :], axis=0)))
    gains = np.array([late[k:, i].sum() ** 2 / len(late[k:]) for k in range(len(late) - LATE_WINDOWS + 1)])
    at = int(np.flatnonzero(gains >= NEARLY * gains.max())[0])
    after = np.median(late[at:], axis=0)
    before = abs(float(np.median(late[:at, i]))) if at else 0.0
    alone = max(float(np.abs(np.delete(after, i)).max()), before) < ALONE * after[i]
    if not alone or (late[at:, i] > LEAST_LAG_S).mean() < SHARE:
        return None
    scatter = max(float(np.nanstd(found.late_s[:, i])), 1.0)
    odd = _lag(found, i, float(known[at]) * LATE_WINDOW_S if at else 0.0, float(after[i]) / scatter)
    return odd if odd.share > LAG_SHARE else None


def _lag(found: Members, i: int, since_s: float, z: float) -> Odd:
    """Return member i with its lag from about that time on: time constant and onset."""
    seen = np.isfinite(found.fine).all(axis=1) & np.isfinite(found.mean)
    time_s = np.arange(len(seen)) * found.step_s
    own = found.by_itself(i, found.fine)
    others = np.interp(time_s, time_s[seen], (found.mean - own / len(found.columns))[seen])

    def off(lag_s: float) -> Array:
        return own - (lagged(others, float(np.exp(-found.step_s / lag_s))) - others)

    after = seen & (time_s >= since_s)
    left = [float(np.var(off(lag_s)[after])) for lag_s in LAGS_S]
    k = int(np.argmin(left))
    if since_s > 0.0:
        # Up to its beginning it was as the others.
        gained = np.where(seen, own**2 - off(LAGS_S[k]) ** 2, 0.0)
        since_s = float(time_s[int(np.argmax(gained[::-1].cumsum()[::-1]))])
    spread = LAGS_S[min(k + 1, len(LAGS_S) - 1)] - LAGS_S[max(k - 1, 0)]
    share = 1.0 - left[k] / max(float(np.var(own[after])), 1e-12)
    return Odd(found.columns[i], LAGS_S[k], 0.5 * spread / NORMAL90, Shape("step", since_s), share, z, LAGS_S[k])
