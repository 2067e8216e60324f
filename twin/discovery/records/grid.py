"""Record on an even grid: means over short bins, in which the diagnosis computes.

Irregular sampling, gaps and repeated stamps end here. A bin without a reading stays NaN. `filled` closes such gaps by
linear interpolation, in the residual and equally in every signature, so that both pass the same linear operation. After
a gap in the inputs the simulation restarts in a new segment (`twin.segments`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel import clean_time, hold_inputs
from twin.network import Array, Network, TwinFileError
from twin.segments import find_segments, segment_rows

BIN_S = 10.0
"""Length of a bin of the grid, s, or the record's own step if that is longer."""
MOST_BINS = 10_800
"""Bins up to which they keep their length; effects in records of days are resolved by blocks of minutes."""
DECIMALS = 6
"""Decimals of a reading, degC, beyond which its digits are those of a calculation."""


class TooShortError(TwinFileError):
    """Error for a record that is too short for a diagnosis of dynamics."""


@dataclass(frozen=True)
class Grid:
    """Bins of `step_s`: `time` (n,) s at their beginnings, `inputs` (n, c), `measured` (n, m) degC with NaN.

    `sigma` (m,) is the white noise of a bin's mean, K. `begins`: bins at which segments begin, each with its own
    initial state; states of a record are the node temperatures (s * k,), degC, at each of them. `centre`: mean time of
    a bin's samples after its beginning, in steps: with one sample a bin, at its beginning, 0; with many, 1/2.
    `resolution` (m,), K: least difference between two values of a sensor's readings, or None if they are none.
    """

    time: Array
    inputs: Array
    measured: Array
    sigma: Array
    step_s: float
    begins: tuple[int, ...] = (0,)
    centre: float = 0.5
    resolution: Array | None = None

    @property
    def segments(self) -> tuple[slice, ...]:
        """Return the bins of each segment, which is simulated without a restart."""
        return segment_rows(self.begins, len(self.time))

    @property
    def span_s(self) -> float:
        return float(self.step_s * len(self.time))

    def part(self, first: int, last: int) -> Grid:
        """Return bins `first` to `last`, the latter excluded."""
        rows = slice(first, last)
        begins = (0, *(b - first for b in self.begins if first < b < last))
        return replace(
            self, time=self.time[rows], inputs=self.inputs[rows], measured=self.measured[rows], begins=begins
        )


def on_grid(
    network: Network, time_s: ArrayLike, inputs: ArrayLike, measured: ArrayLike, least_s: float = BIN_S
) -> Grid:
    """Return means over bins of `least_s`, or of the record's own step if that is longer; of multiples of it for days.

    Parameters
    ----------
    time_s
        (N,) s.
    inputs
        (N, c); in a gap temperatures are interpolated, all else is held.
    measured
        (N, m) degC; NaN is left out.

    Raises
    ------
    TooShortError
        It is too short, or its readings are.
    TwinFileError
        Not a single reading, or the twin has meters.
    """
    if network.meters:
        raise TwinFileError(
            f"a diagnosis takes thermometers only, and twin {network.name!r} has the meter "
            f"{network.meters[0].name!r}; give a twin without meters"
        )
    t, u = clean_time(time_s), bridged(network, time_s, inputs)
    known = find_segments(network, t, np.asarray(inputs, dtype=np.float64))
    y = np.where(known.lost[:, None], np.nan, np.asarray(measured, dtype=np.float64))
    period, step, bins = _bins(network, t, least_s)
    _require_readings(network, t, y)
    where = np.minimum(((t - t[0]) / step + 1e-9).astype(np.intp), bins - 1)
    good = np.isfinite(y)
    count = np.stack([np.bincount(where, good[:, j], bins) for j in range(y.shape[1])], axis=1)
    total = np.stack([np.bincount(where, np.where(good[:, j], y[:, j], 0.0), bins) for j in range(y.shape[1])], axis=1)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    per_bin = max(1.0, step / period)
    grid_time, begins = t[0] + step * np.arange(bins), [0]
    for row in known.begins[1:]:
        before = int(np.flatnonzero(~known.lost[:row])[-1])
        # A bin that began in the gap is of both.
        first = int(where[row]) + int(where[row] == where[row - 1])
        mean[where[before] + 1 : first] = np.nan
        if begins[-1] < first < bins:
            begins.append(first)
    u_means = _held_means(t, u, np.append(grid_time, grid_time[-1] + step), period)
    centre = float(np.mean((t - grid_time[where]) / step))
    return Grid(
        grid_time, u_means, mean, network.sigma / np.sqrt(per_bin), step, tuple(begins), centre, _resolution(network, y)
    )


def _resolution(network: Network, measured: Array) -> Array:
    """Return the least difference (m,), K, between two readings of each sensor (N, m); 0 with fewer than two values.

    The mean of several thermometers has finer steps, but their errors of rounding are independent. Its resolution is
    therefore that of one thermometer with an error of this variance.
    """
    steps = [np.diff(np.unique(np.round(each[np.isfinite(each)], DECIMALS))) for each in measured.T]
    single = [np.sqrt(len(s.measured)) for s in network.sensors]
    return np.array([k * float(step.min()) if step.size else 0.0 for k, step in zip(single, steps, strict=True)])


def require_enough(network: Network, time_s: ArrayLike, measured: ArrayLike, least_s: float = BIN_S) -> None:
    """Check a record before it is put on a grid, with the arguments of `on_grid`.

    Raises
    ------
    TooShortError
        It is too short, or its readings are.
    TwinFileError
        Not a single reading.
    """
    time = clean_time(time_s)
    _bins(network, time, least_s)
    _require_readings(network, time, np.asarray(measured, dtype=np.float64))


def sample_period(time_s: Array) -> float:
    """Return the median interval between samples (N,), s."""
    return float(np.median(np.diff(time_s)))


def _bins(network: Network, t: Array, least_s: float) -> tuple[float, float, int]:
    """Return the period of the samples and the step of the bins, s, and how many bins there are."""
    if len(t) < 2:
        raise TooShortError("the record has fewer than two samples; diagnosis needs at least two windows of data")
    period = sample_period(t)
    step = max(least_s, period)
    step *= max(np.ceil((t[-1] - t[0]) / step / MOST_BINS), 1.0)
    bins = int(np.floor((t[-1] - t[0]) / step + 1e-9)) + 1
    if bins * step < 2.0 * network.rules.window_s:
        raise TooShortError(
            f"the record covers {t[-1] - t[0]:.0f} s; diagnosis needs at least two windows of "
            f"{network.rules.window_s:.0f} s (window_s under [windows] of the twin file)"
        )
    return period, float(step), bins


def _require_readings(network: Network, t: Array, y: Array) -> None:
    """Check that the readings (N, m) of some sensor reach over two windows, as the record must."""
    found = np.isfinite(y)
    if not found.any():
        raise TwinFileError("the record has no reading of any of the twin's sensors; check the names of its columns")
    spans = [float(np.ptp(t[each])) if each.any() else 0.0 for each in found.T]
    if max(spans) < min(network.rules.window_s, float(t[-1] - t[0])):
        best = int(np.argmax(found.sum(axis=0)))
        raise TooShortError(
            f"the readings reach over {max(spans):.0f} s of the record's {t[-1] - t[0]:.0f} s (of {len(t)} rows, "
            f"{found[:, best].sum()} have {network.sensors[best].name}); diagnosis needs readings over at least "
            f"{network.rules.window_s:.0f} s (window_s under [windows] of the twin file)"
        )


def centred(values: Array, centre: float = 0.5) -> Array:
    """Return simulated values (n, ...) at the beginnings of bins as they are `centre` steps later.

    The mean over a bin is the value at its middle. Readings are compared at the mean time of the samples of a bin,
    which with few samples in it is earlier.
    """
    out = np.array(values)
    out[:-1] += centre * (values[1:] - values[:-1])
    return out


def bridged(network: Network, time_s: ArrayLike, inputs: ArrayLike) -> Array:
    """Return inputs (N, c) without NaN: temperatures interpolated over gaps, everything else held."""
    t, given = np.asarray(time_s, dtype=np.float64), np.asarray(inputs, dtype=np.float64)
    u = hold_inputs(network, given)
    for j, column in enumerate(network.input_columns):
        good = np.isfinite(given[:, j])
        if column.endswith("_C") and good.any() and not good.all():
            u[:, j] = np.interp(t, t[good], given[good, j])
    return u


def _held_means(t: Array, u: Array, edges: Array, period: float) -> Array:
    """Return the means over time (bins, c) of held inputs, between edges (bins + 1,) s from the first sample on.

    Samples at long intervals have unequal shares of a bin. A sample holds for one period, since with the next ones lost
    the time of a change is unknown; a bin without any holds the last sample before its end.
    """
    until = np.minimum(np.append(t[1:], np.inf), t + period)
    known = until - t
    # Integrals of 1 and of the inputs at the beginning and at the end of what each sample stands for.
    amounts = np.column_stack([known, u * known[:, None]])
    after = np.cumsum(amounts, axis=0)
    stamps = np.column_stack([t, until]).ravel()
    sums = np.stack([after - amounts, after], axis=1).reshape(len(stamps), -1)
    within = np.diff(np.stack([np.interp(edges, stamps, column) for column in sums.T], axis=1), axis=0)
    seen = within[:, 0]
    latest = u[np.maximum(np.searchsorted(t, edges[1:]) - 1, 0)]
    there = seen > 1e-9 * period
    means = within[:, 1:] / np.where(there, seen, 1.0)[:, None]
    return np.ascontiguousarray(np.where(there[:, None], means, latest))


def filled(values: Array, present: np.ndarray, anchor: int = 1) -> Array:
    """Return `values` (n, m, ...) with linear interpolation where not `present` (n, m); 0 in a column never present.

    Parameters
    ----------
    anchor
        Rows on either side of a gap whose mean is an end point of the line. A single noisy row at the end of a long gap
            would otherwise count as often as the gap has rows.
    """
    out = np.array(values, dtype=np.float64)
    rows = np.arange(len(values))
    for j in range(values.shape[1]):
        good = present[:, j]
        if good.all():
            continue
        if not good.any():
            out[:, j] = 0.0
            continue
        known = np.flatnonzero(good)
        flat = out[:, j].reshape(len(rows), -1)
        right = np.clip(np.searchsorted(known, rows), 0, len(known) - 1)
        left = np.clip(right - 1, 0, len(known) - 1)
        a, b = known[left], known[right]
        share = np.where(b > a, np.clip((rows - a) / np.maximum(b - a, 1), 0.0, 1.0), 1.0)[:, None]
        if anchor > 1:
            sums = np.vstack([np.zeros((1, flat.shape[1])), np.cumsum(flat[known], axis=0)])
            first, last = np.maximum(left + 1 - anchor, 0), np.minimum(right + anchor, len(known))
            before = (sums[left + 1] - sums[first]) / (left + 1 - first)[:, None]
            after = (sums[last] - sums[right]) / (last - right)[:, None]
        else:
            before, after = flat[a], flat[b]
        line = before * (1.0 - share) + after * share
        line[rows < known[0]] = flat[known[:anchor]].mean(axis=0)
        line[rows > known[-1]] = flat[known[-anchor:]].mean(axis=0)
        out[:, j] = np.where(good[:, None], flat, line).reshape(out[:, j].shape)
    return out
