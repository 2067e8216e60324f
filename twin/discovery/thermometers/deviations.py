"""Detection of the thermometer that deviates from others of its place: at once, drifting, now and then, or lagging.

A deviation from the healthy differences (`members`) belongs to one thermometer, to one of their places, or to all
alike. One member is isolated if it has most of the differences.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.shapes import Shape, courses_of, family
from twin.discovery.scoring.equivalence import width
from twin.discovery.thermometers.members import LATE_WINDOW_S, LEAST_MEMBERS, STANDS_OUT, Members, lateness, pattern_of
from twin.first_order_lag import lagged
from twin.network import Array
from twin.quantiles import NORMAL90

SHARE = 0.7
"""Share of the differences that one member must have to be isolated."""
FEWEST_BLOCKS = 6
"""Blocks with all readings from which a deviation is sought: as many as differences are correlated over."""
CORRELATED = 6.0
"""Correlation time of differences between thermometers in a row, in blocks."""
LEAST_OF = 0.2
"""Ratio of two deviating members' deviations from which both count: heat at a place warms its neighbours a little."""
OFTEN = 3
"""Blocks in which one member must deviate alone to have an intermittent fault (decision 0021)."""
LATE_WINDOWS, LEAST_LAG_S, ALONE, NEARLY = 3, 25.0, 0.4, 0.8
"""Windows that a lag must persist for; least lag, s; share of it that any other, or itself before, may have; and share
of the best onset's gain that the earliest onset must reach."""
LAG_SHARE = 0.5
"""Share of a deviation from minute to minute that a lag has to explain; an intermittent fault resembles one."""
LAGS_S = tuple(20.0 * 1.08**k for k in range(45))
"""Time constants that are tried, s."""


@dataclass(frozen=True)
class Deviation:
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


def deviating_member(found: Members, shapes: tuple[Shape, ...] = ()) -> Deviation | None:
    """Return the deviating member, or None.

    Args:
        shapes: time courses that are tried. By default steps at every other block and drifts, a drift only if it is
            significantly better than any step.
    """
    good = found.good
    if len(good) < FEWEST_BLOCKS:
        return None
    best = _largest_deviation(found, good, shapes or _steps(found))
    drift = None if shapes else _largest_deviation(found, good, _drifts(found))
    if drift is not None and (best is None or drift.z**2 > best.z**2 + width(best.z**2)):
        best = drift
    if best is None or best.share < max(SHARE, _share_of_row(found, good, best.shape)):
        return None
    stands_out = abs(best.final) * (1.0 - 1.0 / len(found.columns)) / found.sd[found.columns.index(best.column)]
    return best if stands_out >= STANDS_OUT else None


def apart(found: Members) -> tuple[Members, ...]:
    """Return the group without each of two deviating members in turn; the whole group if there are not two."""
    if len(found.columns) <= LEAST_MEMBERS:
        return (found,)
    whole = deviating_member(found)
    pairs = []
    for column in found.columns if whole is None else (whole.column,):
        second = deviating_member(found.without(column))
        first = None if second is None else deviating_member(found.without(second.column))
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


def _largest_deviation(found: Members, good: np.ndarray, shapes: tuple[Shape, ...]) -> Deviation | None:
    """Return the member, with one of these shapes, that explains most of the squares of `good` blocks."""
    number = len(found.columns)
    courses = courses_of(shapes, found.edges_s)[:, good]
    power = (courses**2).sum(axis=1)
    kept = np.flatnonzero(power > 3.0 * courses.max(axis=1, initial=0.0) ** 2)
    if not len(kept):
        return None
    power = power[kept]
    amplitudes = courses[kept] @ found.residual[good] / power[:, None] / found.sd
    weights = np.stack([pattern_of(i, number) for i in range(number)]) / found.sd
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
    return Deviation(found.columns[i], size, sd, shape, share, float(np.sqrt(gains[k, i])), final)


def _share_of_row(found: Members, good: np.ndarray, shape: Shape) -> float:
    """Return the share of the differences of a time course that the row as a whole has, in one direction.

    A flow that fails warms the end of a row beyond its beginning, as less flow does in health.
    """
    amplitudes = shape.block_means(found.edges_s)[good] @ found.residual[good] / found.sd
    most = float(_along_row(found, amplitudes[None]).max(initial=0.0))
    return most / max(float(amplitudes @ amplitudes), 1e-12)


def _along_row(found: Members, residual: Array) -> Array:
    """Return the squares (b, d) of differences (b, c), in healthy standard deviations, along the row's directions."""
    along = found.row.reshape(-1, len(found.columns)) / found.sd
    squares: Array = (residual @ along.T) ** 2 / np.maximum((along**2).sum(axis=1), 1e-12)
    return squares


def onset_interval(found: Members, deviation: Deviation) -> tuple[float, float]:
    """Return the 90 % interval, s from the record's beginning, of the onset of a member's deviation."""
    good = found.good
    i, edges, end_s = found.columns.index(deviation.column), found.edges_s, float(found.edges_s[-1])
    off = found.by_itself(i, found.residual[good])

    def gain(onset_s: float) -> float:
        shapes = [replace(deviation.shape, onset_s=onset_s)]
        if deviation.shape.name == "ramp":
            ended_s = deviation.shape.onset_s + deviation.shape.growth_s
            shapes += [Shape("ramp", onset_s, g) for g in (ended_s - onset_s, *family("ramp", end_s)) if g > 0.0]
        courses = [shape.block_means(edges)[good] for shape in shapes]
        return max(float(c @ off) ** 2 / max(float(c @ c), 1e-12) for c in courses)

    onsets = np.append(edges[: max(int(0.95 * len(found.residual)), 1)], deviation.shape.onset_s)
    gains = np.array([gain(float(t)) for t in onsets])
    weight = pattern_of(i, len(found.columns)) / found.sd
    able = onsets[gains >= gains.max() - CORRELATED * NORMAL90**2 / float(weight @ weight)]
    block = float(edges[1] - edges[0])
    return max(float(able.min()) - block, 0.0), min(float(able.max()) + block, end_s)


def intermittent_member(found: Members) -> Deviation | None:
    """Return the member with an intermittent fault, which is right on average as with a loose contact; None if there is
    none.

    Its `size` is its largest deviation in a block, its `shape` begins with the first of these blocks, its `share` is
    theirs of all blocks.
    """
    good = np.isfinite(found.residual).all(axis=1)
    residual, number = found.residual[good] / found.sd, found.residual.shape[1]
    total, along = (residual**2).sum(axis=1), _along_row(found, residual)
    best: Deviation | None = None
    for i in range(number):
        weight = pattern_of(i, number) / found.sd
        size = found.by_itself(i, found.residual[good])
        stands_out = np.abs(size) > max(STANDS_OUT * found.sd[i] / (1.0 - 1.0 / number), found.most)
        off = stands_out & (size**2 * (weight @ weight) > np.maximum(SHARE * total, along.max(axis=1, initial=0.0)))
        if off.sum() < OFTEN or (best is not None and off.mean() < best.share):
            continue
        most, first = float(np.abs(size[off]).max()), float(found.edges_s[:-1][good][off][0])
        score = float(np.sqrt((size[off] ** 2).sum() * (weight @ weight)))
        shape = Shape("step", first)
        best = Deviation(found.columns[i], most, float(found.sd[i]), shape, float(off.mean()), score, most)
    return best


def lagging_member(found: Members) -> Deviation | None:
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
    deviation = _lag(found, i, float(known[at]) * LATE_WINDOW_S if at else 0.0, float(after[i]) / scatter)
    return deviation if deviation.share > LAG_SHARE else None


def _lag(found: Members, i: int, since_s: float, z: float) -> Deviation:
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
    return Deviation(found.columns[i], LAGS_S[k], 0.5 * spread / NORMAL90, Shape("step", since_s), share, z, LAGS_S[k])
