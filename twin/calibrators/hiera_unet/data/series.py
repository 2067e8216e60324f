"""Record in the network's steps: means over `STEP_S`, NaN where nothing was read.

A reading of step i is the mean of the samples within half a step of its stamp, an input the mean from its stamp to
the next: the twin's readings are those at the stamp, and its inputs hold from there on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel import clean_time
from twin.network import Array, Network, TwinFileError

STEP_S = 5.0
MOST_STEPS = 6_307_200
"""Steps of a year, the longest record."""


@dataclass(frozen=True)
class ResampledSeries:
    """Segment of a record in n even steps.

    Attributes:
        time: (n,) s. inputs: (n, c), measured: (n, Y) degC, both NaN where missing.
        spread: (n, Y) K, standard deviation between the thermometers of a sensor; NaN for a single one.
        extra: further measured columns that the channel table uses, each (n,).
        hour: clock at time 0, h; NaN if the record does not give it. day: of the year at time 0; NaN likewise.
        earlier: (c,) last inputs that were read before these steps, NaN where none was; or None.
    """

    time: Array
    inputs: Array
    measured: Array
    spread: Array
    extra: Mapping[str, Array] = field(default_factory=dict)
    hour: float = float("nan")
    day: float = float("nan")
    earlier: Array | None = None

    def __len__(self) -> int:
        return len(self.time)

    def part(self, first: int, last: int) -> ResampledSeries:
        """Return steps `first` to `last`, the latter excluded; steps before the beginning have no data."""
        lead = max(-first, 0)
        rows = slice(max(first, 0), last)

        def cut(a: Array) -> Array:
            return np.concatenate([np.full((lead, *a.shape[1:]), np.nan), a[rows]]) if lead else a[rows]

        time = self.time[0] + STEP_S * np.arange(first, last) if lead else self.time[rows]
        extra = {name: cut(a) for name, a in self.extra.items()}
        return ResampledSeries(
            time,
            cut(self.inputs),
            cut(self.measured),
            cut(self.spread),
            extra,
            self.hour,
            self.day,
            latest(self.inputs[: max(first, 0)], self.earlier),
        )

    def ahead(self, count: int) -> ResampledSeries:
        """Return the same with as many future steps, without data."""

        def longer(a: Array) -> Array:
            return np.concatenate([a, np.full((count, *a.shape[1:]), np.nan)])

        time = np.concatenate([self.time, self.time[-1] + STEP_S * np.arange(1, count + 1)])
        extra = {name: longer(a) for name, a in self.extra.items()}
        return ResampledSeries(
            time,
            longer(self.inputs),
            longer(self.measured),
            longer(self.spread),
            extra,
            self.hour,
            self.day,
            self.earlier,
        )


def series(
    network: Network,
    time_s: ArrayLike,
    columns: Mapping[str, ArrayLike],
    *,
    extra: tuple[str, ...] = (),
    hour: float = float("nan"),
    day: float = float("nan"),
) -> ResampledSeries:
    """Resample a record's columns (N,) to even steps.

    Args:
        extra: further columns to include if the record has them.

    Raises:
        TwinFileError: a column that the twin needs is missing, time goes back, or the record is shorter than a step or
            longer than a year.
    """
    t = clean_time(time_s)
    inputs, measured = network.select(columns)
    if len(t) != len(inputs):
        raise TwinFileError(f"time has {len(t)} samples, the columns have {len(inputs)}; cut them to one length")
    if len(t) < 2 or t[-1] - t[0] < STEP_S:
        raise TwinFileError(f"the record covers less than one step of {STEP_S:g} s; give a longer one")
    n = int((t[-1] - t[0]) / STEP_S + 1e-9) + 1
    if n > MOST_STEPS:
        raise TwinFileError(
            f"the record covers {(t[-1] - t[0]) / 86400.0:.0f} days, more than the {MOST_STEPS * STEP_S / 86400.0:.0f} "
            "that fit; correct its stamps or cut it"
        )
    # Sensors take the nearest stamp, inputs the one before.
    near = np.clip(np.floor((t - t[0]) / STEP_S + 0.5 - 1e-9).astype(np.intp), 0, n - 1)
    before = np.minimum(((t - t[0]) / STEP_S + 1e-9).astype(np.intp), n - 1)
    spread = np.full((n, len(network.sensors)), np.nan)
    for j, sensor in enumerate(network.sensors):
        present = [np.asarray(columns[c], dtype=np.float64) for c in sensor.measured if c in columns]
        if len(present) > 1:
            each = binned(np.column_stack(present), near, n)
            spread[:, j] = _spread(each)
    taken = {
        name: binned(np.asarray(columns[name], dtype=np.float64)[:, None], before, n)[:, 0]
        for name in extra
        if name in columns
    }
    return ResampledSeries(
        t[0] + STEP_S * np.arange(n), binned(inputs, before, n), binned(measured, near, n), spread, taken, hour, day
    )


def binned(values: Array, where: np.ndarray, n: int) -> Array:
    """Return means (n, k) over finite values (N, k) that fall into each bin; NaN for an empty one."""
    out = np.full((n, values.shape[1]), np.nan)
    for j in range(values.shape[1]):
        good = np.isfinite(values[:, j])
        count = np.bincount(where[good], minlength=n)
        total = np.bincount(where[good], values[good, j], n)
        np.divide(total, count, out=out[:, j], where=count > 0)
    return out


def filled_forward(values: Array, first: Array, earlier: Array | None = None) -> Array:
    """Return values (n, c) with NaN replaced by the last finite one, `earlier` (c,) included.

    Values before the first finite one take that one, or `first` (c,) if there is none.
    """
    good = np.isfinite(values)
    if good.all():
        return np.ascontiguousarray(values)
    row = np.maximum.accumulate(np.where(good, np.arange(len(values))[:, None], -1), axis=0)
    early = np.where(good.any(axis=0), values[np.argmax(good, axis=0), np.arange(values.shape[1])], first)
    if earlier is not None:
        early = np.where(np.isfinite(earlier), earlier, early)
    out: Array = np.where(row >= 0, np.take_along_axis(values, np.maximum(row, 0), axis=0), early)
    return np.ascontiguousarray(out)


def latest(values: Array, earlier: Array | None = None) -> Array:
    """Return the last finite values (c,) of (n, c), else `earlier` (c,) or NaN."""
    found: Array = np.full(values.shape[1], np.nan) if earlier is None else earlier.copy()
    good = np.isfinite(values)
    for j in np.flatnonzero(good.any(axis=0)):
        found[j] = values[np.flatnonzero(good[:, j])[-1], j]
    return found


def lasting(values: Array, steps: int) -> Array:
    """Return values (n, c) with NaN replaced by the last finite one if that is no more than so many steps old."""
    row = np.arange(len(values))[:, None]
    last = np.maximum.accumulate(np.where(np.isfinite(values), row, -steps - 1), axis=0)
    return np.where(row - last <= steps, np.take_along_axis(values, np.maximum(last, 0), axis=0), np.nan)


def _spread(each: Array) -> Array:
    good = np.isfinite(each)
    count = good.sum(axis=1)
    mean = np.where(good, each, 0.0).sum(axis=1) / np.maximum(count, 1)
    square = (np.where(good, each - mean[:, None], 0.0) ** 2).sum(axis=1) / np.maximum(count, 1)
    out: Array = np.where(count > 1, np.sqrt(square), np.nan)
    return out
