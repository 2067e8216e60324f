"""Readings that cannot be: overload marks, error codes, and numbers outside the plausible range of their unit.

Every column passes here before any mean, fit or picture. A reading that is refused becomes missing, and the record's
messages count it and name the first line.
"""

from __future__ import annotations

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
    *(850.0, -200.0, 1372.0, 1200.0, 1820.0),  # ends of a table: Pt100 (IEC 60751), thermocouples K, J, B (IEC 60584-1)
)
"""The same for temperatures alone: an input may well have such a level."""

FEW = 8
"""Different values from which the rest of a column is a quantity that moves; fewer may be the levels of a switch."""


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
        for code in np.unique(values[_equal(values, codes)]):
            apart = _stand_apart(values, float(code))
            if apart is not None:
                messages.append(_counted(name, apart, values, "a code for no measurement far from all others", place))
                values = np.where(apart, np.nan, values)
    return values


def _equal(values: Values, marks: tuple[float, ...]) -> NDArray[np.bool_]:
    return np.isin(values, marks) | np.isin(values, np.array(marks, dtype=np.float32))


def _stand_apart(values: Values, code: float) -> NDArray[np.bool_] | None:
    """Return the rows (n,) that hold `code` where it cannot be a reading, or None.

    It cannot be one where the empty interval between it and every other value is wider than all that those span: a
    quantity that moves through its range would have been seen in between. A column of a few levels (a switch, a
    set-point) shows nothing, and neither does one that holds the code more often than anything else.
    """
    here = values == code
    others = values[np.isfinite(values) & ~here]
    if here.sum() > len(others) or len(np.unique(others[: 100 * FEW])) < FEW:
        return None
    low, high = float(others.min()), float(others.max())
    return here if max(low - code, code - high) > high - low else None


def _counted(name: str, marks: NDArray[np.bool_], values: Values, why: str, place: Callable[[int], str]) -> str:
    row = int(np.argmax(marks))
    return f"{name}: {_count(marks)} {values[row]:g}, {why}: missing (the first is {place(row)})"


def _count(marks: NDArray[np.bool_]) -> str:
    count = int(marks.sum())
    return "1 values are" if count == 1 else f"{count} values are"
