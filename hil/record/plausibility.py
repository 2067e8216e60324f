"""Impossible readings: overload marks, error codes, and numbers outside the plausible range of their unit.

Every column is checked here before any mean, fit or figure. A reading that is refused becomes missing, and the record's
messages count it and name the first line.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.signals import plausible_range, split_column
from hil.record.values import COLDEST_K, is_difference

Values = NDArray[np.float64]

SENTINELS = (-9999.0, -999.0, 32767.0, -32768.0, 327.67, 3276.7)
"""Values that loggers write in place of a missing temperature; none of them is a temperature of a liquid loop."""

CODES = (-999.0, -9998.0, 6999.0, 7999.0, -6999.0, -7999.0, -273.15, -459.67)
"""Values that devices write instead of a reading of any quantity; 6999 and 7999 are the full scale of Campbell loggers,
and the last two absolute zero in degC and degF.

One of these is taken for a mark only where the rest of the column proves it (`_stand_apart`).
"""
EXTREMES = (
    *(32767, 32768, 65535),  # 16 bits; 32768 with either sign is 0x8000
    *(8388607, 8388608, 16777215),  # 24 bits
    *(2147483647, 2147483648, 4294967295),  # 32 bits
    *(10**digits - 1 for digits in range(4, 11)),  # a field full of nines
)
"""Ends of the ranges of raw integers, of either sign; a device that scales its registers writes them with a point.

One of these over a power of ten is a mark only where it lies apart from all other numbers (`_far_extreme`).
"""
_MOST_DECIMALS = 6
_LEAST_NINES = 999.0
"""Smallest size of a field of nines: 99.99 is a reading of many quantities."""
TEMPERATURE_CODES = (
    *(-99.0, -99.9, 999.0, 999.9),
    *(85.0, -127.0),  # DS18B20: value at power-on, and without a sensor on the wire.
    *(850.0, -200.0, -242.02),  # ends of a table of Pt100 (IEC 60751), and the temperature of its equation at 0 ohm
    *(1372.0, 1370.0, 1200.0, 400.0, 1000.0, 1300.0, 1768.0, 1760.0, 1820.0),  # thermocouples (IEC 60584-1)
    *(-270.0, -210.0, -50.0, -99.99, -100.0),
)
"""Codes for temperatures alone: an input may well have such a level."""
REPEATED = 3
"""Repetitions of the same value from which it may be an unlisted code: noise repeats none."""
FAR_K = 50.0
"""Distance in K from all other values from which such a value may be a code: no sensor of a rig jumps so far in one
row.
"""
_MOST_CODES = 4
"""Most codes of one column: sensor open, sensor short, above and below the range."""
_LEVELS = re.compile(r"(^|_)(set|setpoint|sp|soll|target|ref|reference|demand|cmd)(_|\d|$)|setpoint|sollwert", re.I)
"""Names of set-points, which jump between levels."""

_COLDEST = {"degC": -272.0, "K": 1.15, "degF": -457.6}
"""Lower end of readings by unit: 1.15 K, below which no thermometer of a rig works.

Absolute zero is a register of zeros or a conversion without an input, and loggers round it to -273 or -273.2.
"""
_DRIVEN = ("W", "kW", "%", "V", "mV", "kV", "A", "mA", "VA", "var", "rpm", "Hz", "1")
"""Units of quantities that a controller may switch for single rows; a pulse of them is no code."""
FEW = 8
"""Fewest different values of a continuous quantity; fewer may be the levels of a switch."""
FAR_FACTOR = 10.0
"""Ratio of a code to the largest of a few levels, above which it is none of them: levels of one switch are of one size.
"""
STEPS = 2.0
"""Largest steps between rows that fit into the empty interval next to a code, which then was passed in one step."""


def without_implausible(
    name: str,
    values: Values,
    place: Callable[[int], str],
    messages: list[str],
    declared: tuple[float, float] | None = None,
    written: Values | None = None,
) -> Values:
    """Return `values (n,)` of column `name`, in the unit of its suffix, with NaN in place of impossible readings.

    Parameters
    ----------
    place
        Names a row of the file, for the messages.
    messages
        Takes a sentence for each kind of refused value.
    declared
        Plausible range of the point, in the column's unit; the default of the unit where None.
    written
        Numbers (n,) as the file has them, where another unit or a factor was converted: codes are among these.
    """
    parts = split_column(name)
    unit = parts[1] if parts else "1"
    converted = written is not None and not np.array_equal(written, values, equal_nan=True)
    numbers = values if written is None else written
    temperature = name.startswith("T_") and name.endswith("_C") and not converted
    marks = _equal(values, SENTINELS) if temperature else np.zeros(len(values), dtype=bool)
    if marks.any():
        messages.append(_counted(name, marks, values, "a mark for no measurement", place))
        values = np.where(marks, np.nan, values)
    low, high = declared or plausible_range(unit)
    coldest = _coldest(name, unit, values)
    low = coldest if declared is None and coldest > -np.inf else max(low, coldest)
    with np.errstate(invalid="ignore"):
        outside = (values < low) | (values > high)
    if outside.any():
        row = int(np.argmax(outside))
        known = int(np.isfinite(values).sum())
        shown = "" if unit == "1" else f" {unit}"
        asked = "; is the column in another unit?" if outside.sum() > known / 2 else ""
        messages.append(
            f"{name}: {_count(outside)} outside {low:g} to {high:g}{shown} (the first, {place(row)}, is "
            f"{values[row]:g}): missing{asked}"
        )
        values = np.where(outside, np.nan, values)
    numbers = np.where(np.isnan(values), np.nan, numbers)
    found = extremes = _extremes(numbers)
    listed = (*CODES, *TEMPERATURE_CODES) if unit == "degC" and not converted else CODES
    found = [*found, *(code for code in np.unique(numbers[_equal(numbers, listed)]).tolist() if code not in found)]
    if parts and _LEVELS.search(parts[0]) is None:
        unlisted = _repeated(numbers) if unit in ("degC", "K") else [] if unit in _DRIVEN else _isolated(numbers)
        found += [code for code in unlisted if code not in found]
    for code in 2 * found:  # The value farthest out hides the others from the first pass.
        apart = _far_extreme(numbers, code, parts is not None) if code in extremes else _stand_apart(numbers, code)
        if apart is not None:
            messages.append(_counted(name, apart, numbers, "a code for no measurement far from all others", place))
            values, numbers = np.where(apart, np.nan, values), np.where(apart, np.nan, numbers)
    return values


def _coldest(name: str, unit: str, values: Values) -> float:
    """Return the lower end of absolute temperatures in `values (n,)`; minus infinity for any other quantity.

    A column in K holds absolute temperatures where most numbers but zero are as large as those are, and no difference.
    """
    if name.endswith(("_F", "_degF")):
        return _COLDEST["degF"]
    if unit == "degC":
        others = values[np.isfinite(values) & (values > _COLDEST[unit])]  # All colder than any rig: differences in K.
        is_absolute = not len(others) or float(np.median(others)) > COLDEST_K - 273.15
        return _COLDEST[unit] if is_absolute else -273.15
    if unit != "K":
        return -np.inf
    known = values[np.isfinite(values) & (values != 0.0)]
    is_absolute = len(known) > 0 and float(np.median(known)) > COLDEST_K and not is_difference(name)
    return _COLDEST[unit] if is_absolute else -np.inf


def _extremes(numbers: Values) -> list[float]:
    """Return the different numbers that are an end of a raw integer's range over a power of ten, farthest first."""
    different = np.unique(numbers[np.isfinite(numbers)])
    if len(different) > 4 * _MOST_CODES:  # A code lies at an end of all numbers.
        different = np.concatenate([different[: 2 * _MOST_CODES], different[-2 * _MOST_CODES :]])
    found = np.zeros(len(different), dtype=np.bool_)
    for decimals in range(_MOST_DECIMALS + 1):
        counts = np.abs(different) * 10.0**decimals
        whole = np.round(counts)
        found |= np.isin(whole, EXTREMES) & (np.abs(counts - whole) <= 1e-7 * whole)
    codes = [code for code in different[found].tolist() if abs(code) >= _LEAST_NINES or not _is_nines(code)]
    return sorted(codes, key=lambda code: -abs(code))


def _is_nines(code: float) -> bool:
    return set(f"{abs(code):.10g}".lstrip("0.")) <= set("9.")


def _far_extreme(numbers: Values, code: float, has_unit: bool) -> NDArray[np.bool_] | None:
    """Return the rows (n,) that hold `code`, the end of a raw integer's range, if it cannot be a reading, or None.

    The empty interval between it and all other values is wider than all that those span, or than `STEPS` of their
    largest steps. It may fill most of the column. Others of a few levels (a switch) show nothing, unless the code is
    `FAR_FACTOR` times as large as the largest and the column has a unit; nines may be the full power of a switch.
    """
    here = numbers == code
    others = numbers[np.isfinite(numbers) & ~here]
    if not here.any() or not len(others):
        return None
    low, high = float(others.min()), float(others.max())
    apart = float(np.abs(others - code).min())
    largest = max(abs(low), abs(high))
    is_few = len(np.unique(others[: 100 * FEW])) < FEW
    switches = high - low > largest / 2 and _is_nines(code)
    if is_few and (switches or not (has_unit and 0.0 < FAR_FACTOR * largest < abs(code))):
        return None
    step = float(np.abs(np.diff(others)).max()) if len(others) > 1 else 0.0
    outside = code < low or code > high
    return here if outside and (apart > high - low or apart > STEPS * step > 0.0) else None


def _repeated(values: Values) -> list[float]:
    """Return unlisted codes: values at an end of a column of temperatures, repeated exactly and far from all others.

    Each has other values before and after it, so that a record that begins cold has none. Zero is none, since a
    controller may hold it.
    """
    left = values[np.isfinite(values)]
    found: list[float] = []
    for _ in range(_MOST_CODES):
        ends = (float(left.min()), float(left.max())) if len(left) else ()
        for end in ends:
            rows = np.flatnonzero(left == end)
            others = left[left != end]
            if len(rows) < REPEATED or end == 0.0 or not len(others) or np.abs(others - end).min() < FAR_K:
                continue
            inner = (rows > np.argmax(left != end)) & (rows < len(left) - 1 - np.argmax(left[::-1] != end))
            if inner.any() and _stand_apart(left, end) is not None:
                found.append(end)
                left = others
                break
        else:
            break
    return found


def _isolated(values: Values) -> list[float]:
    """Return unlisted codes of a measured quantity that has no scale of its own: exact repetitions in isolated rows.

    Each lies at an end, farther from all others than `FAR_FACTOR` times what those span. Before and after each of its
    rows the quantity is the same, so that nothing happened in between. Zero is none, since a pump may stop.
    """
    known = values[np.isfinite(values)]
    found: list[float] = []
    for end in (float(known.min()), float(known.max())) if len(known) else ():
        others = known[known != end]
        if end == 0.0 or len(others) < 2 or (known == end).sum() < REPEATED:
            continue
        span = float(np.ptp(others))
        rows = np.flatnonzero(known == end)
        alone = (rows[0] > 0) and (rows[-1] < len(known) - 1) and bool((np.diff(rows) > 1).sum() >= REPEATED - 1)
        if alone and float(np.abs(others - end).min()) > FAR_FACTOR * span and _carries_on(known, rows):
            found.append(end)
    return found


def _carries_on(values: Values, rows: NDArray[np.int64]) -> bool:
    """Return True where values go on after `rows` as before them, with no larger steps than between other rows."""
    others = np.delete(values, rows)
    joints = rows - np.arange(len(rows))  # Place in `others` of the first value after each row.
    steps = np.abs(np.diff(others))
    places, counts = np.unique(joints, return_counts=True)
    between = np.delete(steps, places - 1)
    return bool(len(between)) and bool((steps[places - 1] <= (counts + 1) * between.max()).all())


def _equal(values: Values, marks: tuple[float, ...]) -> NDArray[np.bool_]:
    return np.isin(values, marks) | np.isin(values, np.array(marks, dtype=np.float32))


def _stand_apart(values: Values, code: float) -> NDArray[np.bool_] | None:
    """Return the rows (n,) that hold `code` if it cannot be a reading, or None.

    It cannot be one where the empty interval between it and every other value is wider than all that those span, or,
    between rows of other values, than `STEPS` of their largest steps: a quantity that moves through its range would
    have been seen in between. A column of a few levels (a switch, a set-point) shows nothing, and neither does one that
    holds the code more often than anything else.
    """
    here = values == code
    others = values[np.isfinite(values) & ~here]
    if not here.any() or here.sum() > len(others) or len(np.unique(others[: 100 * FEW])) < FEW:
        return None
    low, high = float(others.min()), float(others.max())
    if max(low - code, code - high) > high - low:
        return here
    rows = np.flatnonzero(here)
    known = np.flatnonzero(np.isfinite(values) & ~here)
    between = (rows > known[0]) & (rows < known[-1])
    apart = float(np.abs(others - code).min())
    return here if between.any() and apart > STEPS * float(np.abs(np.diff(others)).max()) else None


def _counted(name: str, marks: NDArray[np.bool_], values: Values, why: str, place: Callable[[int], str]) -> str:
    row = int(np.argmax(marks))
    return f"{name}: {_count(marks)} {values[row]:g}, {why}: missing (the first is {place(row)})"


def _count(marks: NDArray[np.bool_]) -> str:
    count = int(marks.sum())
    return "1 values are" if count == 1 else f"{count} values are"
