"""Single suspicious rows: a reading or an input that deviates from both its neighbours for one row, and returns.

A step of the rig, a ramp and correlated noise differ from one neighbour at most, or on opposite sides. A row counts if
it deviates from the rows before and from those after, in the same direction, by more than noise does anywhere in the
record with probability `LEVEL` (Bonferroni, an upper bound).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, ndtri

from twin.discovery.leads.concentration import DRAWS, LEVEL
from twin.network import Array

MOST_ROWS = 5
"""Rows that are named at most. An input that deviates for one row more often than that is expected to do so."""
MAD = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""
ON_A_SIDE = 2
"""Rows on either side whose mean a row is compared with; the variance of the difference is 1 + 1 / `ON_A_SIDE`."""
AROUND = 100
"""Rows of which noise is estimated by its median step: to a tenth."""
APART = 3.0
"""Typical steps beyond which the next row is no neighbour."""


@dataclass(frozen=True)
class Suspicious:
    """A row by its number, the columns in which it is off, by how much (in their units), and in units of noise.

    `times` is 0 for an input without noise.
    """

    row: int
    columns: tuple[int, ...]
    off: tuple[float, ...]
    times: float


def suspicious_readings(time_s: Array, measured: Array, simulated: Array, sigma: Array) -> tuple[Suspicious, ...]:
    """Return the rows of which a reading, or the readings together, leave their neighbours; the farthest first.

    Both the readings and their difference from the twin must: the one alone may be the rig in motion, the other the
    twin between its steps.

    Parameters
    ----------
    time_s, measured, simulated
        (N,) s and (N, m) degC, NaN where nothing is measured.
    sigma
        (m,) K, declared noise of a reading, taken where the readings do not show theirs.
    """
    n, m = measured.shape
    left = measured - simulated
    before, after = np.full((n, m), np.nan), np.full((n, m), np.nan)
    scale = np.array([max(_noise(x, s), _quantum(y)) for x, y, s in zip(left.T, measured.T, sigma, strict=True)])
    for j in np.flatnonzero(scale > 0.0):
        pairs = zip(_sides(time_s, measured[:, j]), _sides(time_s, left[:, j]), strict=True)
        before[:, j], after[:, j] = (_both(own, other) / scale[j] for own, other in pairs)
    sd = np.sqrt(1.0 + 1.0 / ON_A_SIDE)
    off = _both(before, after)
    tests = max(int(np.isfinite(off).sum()) + n, 1)
    single = np.abs(off) > -sd * ndtri(0.5 * LEVEL / tests)
    known = np.isfinite(off)
    squares = np.minimum(*(np.where(known, x, 0.0).__pow__(2).sum(axis=1) for x in (before, after))) / sd**2
    one_way = np.where(known, before * after, 0.0).sum(axis=1) > 0.0
    together = one_way & (squares > chdtri(np.maximum(known.sum(axis=1), 1), LEVEL / tests))
    found = []
    for row in np.flatnonzero(single.any(axis=1) | together):
        alone = np.flatnonzero(single[row])
        columns = alone if alone.size else np.flatnonzero(known[row])
        each = off[row] if alone.size else 0.5 * (before[row] + after[row])
        size = [float(each[j] * scale[j]) for j in columns]
        times = float(np.abs(off[row, alone]).max()) if alone.size else float(np.sqrt(squares[row]))
        found.append(Suspicious(int(row), tuple(int(j) for j in columns), tuple(size), times))
    return tuple(sorted(found, key=lambda s: -s.times))


def suspicious_inputs(time_s: Array, inputs: Array, least: Array) -> tuple[Suspicious, ...]:
    """Return the rows in which an input leaves its level for one row; the farthest first.

    An input that is held has no noise: of it only rare rows count that return to the very level which they left.

    Parameters
    ----------
    time_s, inputs
        (N,) s and (N, c).
    least
        (c,) by how much an input that is held must leave its level: a flicker of its last digit is rounding.
    """
    found: list[Suspicious] = []
    sd = np.sqrt(1.0 + 1.0 / ON_A_SIDE)
    limit = -sd * ndtri(0.5 * LEVEL / max(inputs.size, 1))
    for j in range(inputs.shape[1]):
        before, after = _sides(time_s, inputs[:, j])
        off = _both(before[:, None], after[:, None])[:, 0]
        noise = _noise_of_rows(inputs[:, j])
        if noise.any():
            rows = np.flatnonzero(np.abs(off) > limit * noise)
        else:
            same = 1e-9 * float(np.abs(least[j]))
            rows = np.flatnonzero((np.abs(off) > least[j]) & (np.abs(before - after) <= same))
        if len(rows) <= MOST_ROWS or noise.any():
            times = [abs(off[r]) / noise[r] if noise.any() else 0.0 for r in rows]
            found += [Suspicious(int(r), (j,), (float(off[r]),), t) for r, t in zip(rows, times, strict=True)]
    return tuple(sorted(found, key=lambda s: -s.times))


def near_steps(inputs: Array, least: Array) -> np.ndarray:
    """Return the rows (N,) beside a step of an input, after which a fast place may well leave its neighbours.

    Parameters
    ----------
    inputs
        (N, c).
    least
        (c,) size of a step that counts, beside that of an input's own noise.
    """
    near = np.zeros(len(inputs), dtype=bool)
    for values, size in zip(inputs.T, least, strict=True):
        noise = -ndtri(0.5 * LEVEL / max(len(values), 1)) * np.sqrt(2.0) * _noise_of_rows(values)
        limit = np.maximum(float(size), np.maximum(noise[1:], noise[:-1]))
        for row in np.flatnonzero(np.abs(np.diff(values)) > limit):
            near[max(row + 1 - ON_A_SIDE, 0) : row + 1 + ON_A_SIDE] = True
    return near


def suspicious_states(left: Array, sigma: Array) -> tuple[Suspicious, ...]:
    """Return the steady states (rows) far off from all others, by residuals `left` (n, m) K; the farthest first.

    The scale of a reading is the median deviation of all states, the declared noise (m,) at least, so that a twin which
    fits none of them names none. The threshold is simulated for as many states.
    """
    scale = np.array(
        [
            max(MAD * float(np.median(np.abs(x))) if (x := c[np.isfinite(c)]).size else 0.0, s)
            for c, s in zip(left.T, sigma, strict=True)
        ]
    )
    times = np.abs(left) / scale
    known = np.isfinite(left)
    draws = np.where(known, np.random.default_rng(0).standard_normal((DRAWS, *left.shape)), np.nan)
    read = known.any(axis=0)
    spread = MAD * np.nanmedian(np.abs(draws[:, :, read]), axis=1, keepdims=True)
    highest = np.nanmax(np.abs(draws[:, :, read]) / spread, axis=(1, 2))
    limit = float(np.sort(highest)[round((DRAWS + 1) * (1.0 - LEVEL)) - 1])
    rows = np.flatnonzero((np.where(known, times, 0.0) > limit).any(axis=1))
    found = [
        Suspicious(
            int(r),
            tuple(int(j) for j in np.flatnonzero(times[r] > limit)),
            tuple(float(x) for x in left[r][times[r] > limit]),
            float(np.nanmax(times[r])),
        )
        for r in rows
    ]
    return tuple(sorted(found, key=lambda s: -s.times))


def _noise(values: Array, declared: float) -> float:
    """Return the standard deviation of a column's noise from its steps; 0 for a column that is held."""
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    if not steps.size:
        return 0.0
    return MAD * float(np.median(steps)) / np.sqrt(2.0) or declared


def _noise_of_rows(values: Array) -> Array:
    """Return the standard deviation of a column's noise at each row (n,); all 0 for a column that is held.

    Noise may be relative to the level, or come and go. So that of a row is the largest of the whole column, of the rows
    around it in time, and of the rows around it in the order of levels. The level is a median, which no spike moves.
    """
    whole = _noise(values, 0.0)
    noise = np.full(len(values), whole)
    good = np.flatnonzero(np.isfinite(values))
    if not whole or len(good) < 2 * AROUND:
        return noise
    v = values[good]
    steps = np.abs(np.diff(v, append=v[-1]))
    levels = np.median(
        np.lib.stride_tricks.sliding_window_view(np.pad(v, ON_A_SIDE, mode="edge"), 1 + 2 * ON_A_SIDE), axis=1
    )
    for order in (np.arange(len(v)), np.argsort(levels, kind="stable")):
        lengths, medians = _medians_of_parts(steps[order], len(order) // AROUND)
        wide = np.pad(MAD * medians / np.sqrt(2.0), 1, mode="edge")
        around = np.repeat(np.maximum(np.maximum(wide[:-2], wide[1:-1]), wide[2:]), lengths)
        noise[good[order]] = np.maximum(noise[good[order]], around)
    return noise


def _medians_of_parts(values: Array, count: int) -> tuple[np.ndarray, Array]:
    """Return the lengths and the medians of `count` parts in a row, as equal in length as whole numbers allow."""
    short, longer = divmod(len(values), count)
    cut = longer * (short + 1)
    parts = values[:cut].reshape(longer, short + 1), values[cut:].reshape(count - longer, short)
    lengths = np.repeat([short + 1, short], [longer, count - longer])
    return lengths, np.concatenate([np.median(rows, axis=1) for rows in parts if len(rows)])


def _quantum(values: Array) -> float:
    """Return the least step of a column, below which it shows no noise; 0 for a column that does not move."""
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    return float(steps[steps > 0.0].min()) if (steps > 0.0).any() else 0.0


def _sides(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Return by how much each row (N,) is above the mean of the rows before it and of those after; NaN without them."""
    before, after = np.full(len(values), np.nan), np.full(len(values), np.nan)
    good = np.flatnonzero(np.isfinite(values))
    if len(good) < 2 * ON_A_SIDE + 1:
        return before, after
    v, t = values[good], time_s[good]
    means = np.convolve(v, np.full(ON_A_SIDE, 1.0 / ON_A_SIDE), mode="valid")
    near = APART * ON_A_SIDE * float(np.median(np.diff(time_s)))
    early = np.arange(ON_A_SIDE, len(v))
    early = early[t[early] - t[early - ON_A_SIDE] <= near]
    before[good[early]] = v[early] - means[early - ON_A_SIDE]
    late = np.arange(len(v) - ON_A_SIDE)
    late = late[t[late + ON_A_SIDE] - t[late] <= near]
    after[good[late]] = v[late] - means[late + 1]
    return before, after


def _both(before: Array, after: Array) -> Array:
    """Return the smaller of two deviations of one sign, 0 where their signs differ, NaN where one is missing."""
    smaller = np.where(np.abs(before) < np.abs(after), before, after)
    found: Array = np.where(before * after < 0.0, 0.0, smaller)
    found[np.isnan(before) | np.isnan(after)] = np.nan
    return found
