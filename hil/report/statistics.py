"""Statistics of every signal of a run, and the formats of numbers and times in a report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Quality
from hil.journal import Header, JournalSamples
from hil.report.actuators import pair_actuators

NONE = "-"
"""Cell of an unknown number."""
SETTLED_AFTER_S = 60.0
"""Time in s for which a set-point must be constant before its read-back is compared: before, ramps and lags are at
work.
"""


@dataclass(frozen=True, slots=True)
class TimeUnit:
    """Unit of time: its symbol and its length in s."""

    symbol: str
    seconds: float

    def of(self, time_s: float | None, digits: int = 2) -> str:
        """Return a time in this unit, without the symbol; `NONE` if it is unknown."""
        return NONE if time_s is None else number(time_s / self.seconds, f".{digits}f")


def time_unit(duration_s: float) -> TimeUnit:
    """Return the greatest unit that a run of `duration_s` has three of: two decimals then distinguish its events."""
    for unit in (TimeUnit("d", 86400.0), TimeUnit("h", 3600.0), TimeUnit("min", 60.0)):
        if duration_s >= 3.0 * unit.seconds:
            return unit
    return TimeUnit("s", 1.0)


def symbol(unit: str) -> str:
    """Return a unit in display form: `degC` as `°C`, nothing for a pure number."""
    return {"degC": "°C", "1": ""}.get(unit, unit)


def number(value: float | None, form: str = ".4g") -> str:
    """Return a number in the form of a cell; `NONE` if there is none."""
    return NONE if value is None or not math.isfinite(value) else f"{value:{form}}"


@dataclass(frozen=True, slots=True)
class SignalStatistics:
    """Least, mean and greatest good value of one signal in its unit, NaN without any; `good` is the share of ticks."""

    name: str
    unit: str
    least: float
    mean: float
    greatest: float
    good: float


@dataclass(frozen=True, slots=True)
class SetAgainstRead:
    """Set-point and read-back, both in `unit`: means over all ticks with both, and over the ticks with a set-point
    constant for `SETTLED_AFTER_S` the mean difference (read minus set) and the greatest, NaN without.
    """

    name: str
    unit: str
    set_mean: float
    read_mean: float
    settled_difference: float
    settled_greatest: float


def good_values(samples: JournalSamples) -> NDArray[np.float64]:
    """Return the values (n, k), NaN if the quality is not GOOD."""
    return np.where(samples.quality == Quality.GOOD, samples.values, np.nan)


def signal_statistics(header: Header, samples: JournalSamples) -> list[SignalStatistics]:
    """Return the statistics of every signal, measured ones first, in the rig's order."""
    values = good_values(samples)
    kinds = {"measured": 0, "setpoint": 1, "status": 2}
    found = []
    for index in sorted(range(len(header.signals)), key=lambda k: kinds[header.signals[k].kind]):
        signal, column = header.signals[index], values[:, index]
        finite = column[np.isfinite(column)]
        spread = (finite.min(), finite.mean(), finite.max()) if len(finite) else (math.nan,) * 3
        least, mean, greatest = map(float, spread)
        good = len(finite) / max(len(column), 1)
        found.append(SignalStatistics(signal.name, symbol(signal.unit), least, mean, greatest, good))
    return found


def set_against_read(header: Header, samples: JournalSamples) -> list[SetAgainstRead]:
    """Return the comparison of every set-point that has a read-back."""
    values = good_values(samples)
    index = {signal.name: k for k, signal in enumerate(header.signals)}
    found = []
    for stem, (setpoint, *read) in pair_actuators(header.signals).items():
        if not read:
            continue
        wanted, there = values[:, index[setpoint.name]], values[:, index[read[0].name]]
        both = np.isfinite(wanted) & np.isfinite(there)
        settled = both & _stood(wanted, samples.time_s)
        off = (there - wanted)[settled]
        found.append(
            SetAgainstRead(
                stem,
                symbol(setpoint.unit),
                _mean(wanted[both]),
                _mean(there[both]),
                _mean(off),
                float(off[np.argmax(np.abs(off))]) if len(off) else math.nan,
            )
        )
    return found


def _stood(wanted: NDArray[np.float64], time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the ticks (n,) on which a set-point has been constant for `SETTLED_AFTER_S`."""
    if not len(wanted):
        return np.zeros(0, dtype=np.bool_)
    changed = np.concatenate([[True], ~(wanted[1:] == wanted[:-1])])
    since = np.maximum.accumulate(np.where(changed, np.arange(len(wanted)), 0))
    return np.asarray(time_s - time_s[since] >= SETTLED_AFTER_S)


def _mean(values: Sequence[float] | NDArray[np.float64]) -> float:
    return float(np.mean(values)) if len(values) else math.nan
