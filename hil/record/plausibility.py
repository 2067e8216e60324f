"""Impossible readings: overload marks, error codes, and numbers outside the plausible range of their unit.

Every column passes here before any mean, fit or picture. A reading that is refused becomes missing, and the record's
messages count it and name the first line.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.signals.units import plausible_range, split_column

Values = NDArray[np.float64]

SENTINELS = (-9999.0, -999.0, 32767.0, -32768.0, 327.67, 3276.7)
"""Values that loggers write into a temperature when there is none; none of them is a temperature of a liquid loop."""

CODES = (
    *(-9999.0, -9998.0, -999.9, -999.0, 9999.0, 99999.0, 999999.0),  # a field full of nines
    *(32767.0, -32768.0, 3276.7, -3276.8, 327.67, -327.68, 65535.0, 6553.5, 2147483647.0),  # ends of an integer
    *(6999.0, 7999.0, -6999.0, -7999.0),  # Campbell loggers: full scale of 13 and 16 bit values
)
"""Values inside the range of some unit that devices write instead of a reading of any quantity.

One of these is taken for a mark only where the rest of the column proves it (`_stand_apart`).
"""
TEMPERATURE_CODES = (
    *(-99.0, -99.9, 999.0, 999.9),
    *(85.0, -127.0),  # DS18B20: value at power-on, and no sensor on the wire
    *(850.0, -200.0, -242.02),  # ends of a table of Pt100 (IEC 60751), and the temperature of its equation at 0 ohm
    *(1372.0, 1370.0, 1200.0, 400.0, 1000.0, 1300.0, 1768.0, 1760.0, 1820.0),  # thermocouples (IEC 60584-1)
    *(-270.0, -210.0, -50.0, -99.99, -100.0),
)
"""The same for temperatures alone: an input may well have such a level."""
REPEATED = 3
"""Times that a device writes the same value from which it may be a code that no list holds: noise repeats none."""
FAR_K = 50.0
"""Distance from all other values from which such a value may be a code: no sensor of a rig jumps so far in a row."""
_MOST_CODES = 4
"""Different codes of one column that are looked for: sensor open, sensor short, above and below the range."""
_LEVELS = re.compile(r"(^|_)(set|setpoint|sp|soll|target|ref|reference|demand|cmd)(_|\d|$)|setpoint|sollwert", re.I)
"""Names of set-points, which jump between levels."""

FEW = 8
"""Different values from which the rest of a column is a quantity that moves; fewer may be the levels of a switch."""
STEPS = 2.0
"""Largest steps between rows that fit into the empty interval beside a code, which then was passed in one."""


def without_implausible(
    name: str, values: Values, place: Callable[[int], str], messages: list[str],
    declared: tuple[float, float] | None = None,
) -> Values:  # fmt: skip
    """Return `values (n,)` of column `name`, in the unit of its suffix, with NaN where no reading can be.

    Args:
        place: names a row of the file, for the messages.
        messages: takes a sentence for each kind of refused value.
        declared: plausible range of the point, in the column's unit; the default of the unit where None.
    """
    parts = split_column(name)
    unit = parts[1] if parts else "1"
    temperature = name.startswith("T_") and name.endswith("_C")
    marks = _equal(values, SENTINELS) if temperature else np.zeros(len(values), dtype=bool)
    if marks.any():
        messages.append(_counted(name, marks, values, "a mark for no measurement", place))
        values = np.where(marks, np.nan, values)
    low, high = declared or plausible_range(unit)
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
    if parts:
        codes = (*CODES, *TEMPERATURE_CODES) if unit == "degC" else CODES
        found = np.unique(values[_equal(values, codes)]).tolist()
        if unit in ("degC", "K") and _LEVELS.search(parts[0]) is None:
            found += [code for code in _repeated(values) if code not in found]
        for code in 2 * found:  # the one farthest out hides the others from the first look
            apart = _stand_apart(values, float(code))
            if apart is not None:
                messages.append(_counted(name, apart, values, "a code for no measurement far from all others", place))
                values = np.where(apart, np.nan, values)
    return values


def _repeated(values: Values) -> list[float]:
    """Return codes of no list: values at an end of a column of temperatures, repeated exactly and far from all others.

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


def _equal(values: Values, marks: tuple[float, ...]) -> NDArray[np.bool_]:
    return np.isin(values, marks) | np.isin(values, np.array(marks, dtype=np.float32))


def _stand_apart(values: Values, code: float) -> NDArray[np.bool_] | None:
    """Return the rows (n,) that hold `code` where it cannot be a reading, or None.

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
