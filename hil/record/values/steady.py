"""Questions about columns whose numbers change as no measurement does: they stand still, or jump by a unit.

They are questions, since a valve may close and a unit may be changed on purpose.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.signals import split_column
from hil.record.values.question import UnitQuestion

LEAST_EQUAL = 20
"""Fewest equal values in a row that may be a sensor that stands still: a noisy one repeats itself a few times."""
RARE = 10.0
"""Ratio of that many to the next longest such row of equal values: one of a coarse sensor has others of its size."""
CHANGES = 0.4
"""Share of steps that change elsewhere from which a column has noise: a coarse sensor repeats every second value."""
FAR_STEPS = 20.0
"""Typical steps in a jump that is none of the quantity itself."""
SAME = 0.05
"""Relative difference of a jump to that between two units up to which it is one: units differ by far more."""
AROUND = 10
"""Samples before and after a jump whose medians must differ as the jump does, so that it stays."""
_TEMPERATURES = (
    (1.8, 32.0, "degC to degrees Fahrenheit"),
    (1.0 / 1.8, -32.0 / 1.8, "degrees Fahrenheit to degC"),
    (1.0, 273.15, "degC to kelvin"),
    (1.0, -273.15, "kelvin to degC"),
)
_SCALES = ((1e-3, 0.0, "a unit to its thousandfold"), (1e3, 0.0, "a unit to its thousandth"))
_SCALED = ("W", "kW", "Pa", "kPa", "V", "mV", "A", "mA")
"""Units of which loggers also write the thousandfold or the thousandth."""


def standing_still(time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]) -> list[str]:
    """Return a question for the columns that stand still for a part of a record and have noise elsewhere.

    `time_s (n,)` and each column (n,) are in the order of time. Zero and the ends of a column's range are levels at
    which an actuator may rest; only temperatures can stand still there.
    """
    found: dict[tuple[int, int], list[str]] = {}
    for name, values in columns.items():
        parts = split_column(name)
        if parts is None or (span := _longest_equal(values)) is None:
            continue
        level = float(values[span[0]])
        rests = level in (0.0, float(np.nanmin(values)), float(np.nanmax(values)))
        if parts[1] in ("degC", "K") or not rests:
            found.setdefault(span, []).append(f"{name} at {level:.6g}")
    said = []
    for (first, last), names in sorted(found.items()):
        verb, who = ("stands", "the channel") if len(names) == 1 else ("stand", "the logger")
        listed = ", ".join(names[:4]) + (f" and {len(names) - 4} others" if len(names) > 4 else "")
        said.append(
            f"{listed} {verb} still for {last - first + 1} samples from {time_s[first]:g} s on, with noise elsewhere: "
            f"is {who} stuck?"
        )
    return said


def unit_jumps(time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]) -> list[str]:
    """Return a question for each column that jumps, and stays, by as much as two of its units differ.

    `time_s (n,)` and each column (n,) are in the order of time.
    """
    said: list[str] = []
    for name, values in columns.items():
        parts = split_column(name)
        ways = () if parts is None else _TEMPERATURES if parts[1] in ("degC", "K") else _SCALES
        if parts is None or (ways is _SCALES and parts[1] not in _SCALED):
            continue
        known = np.flatnonzero(np.isfinite(values))
        here = values[known]
        steps = np.abs(np.diff(here))
        if len(steps) < 2 * AROUND or not (steps > 0.0).any():
            continue
        far = np.flatnonzero(steps > FAR_STEPS * np.median(steps[steps > 0.0]))
        for at in far[np.argsort(-steps[far])][:AROUND].tolist():
            before, after = here[max(at + 1 - AROUND, 0) : at + 1], here[at + 1 : at + 1 + AROUND]
            if ways is _SCALES:
                way = next((word for factor, _, word in ways if _is_scaled(here, at, factor)), None)
            else:
                way = next((word for a, b, word in ways if _differs_by(here, at, before, after, a, b)), None)
            if len(before) == len(after) == AROUND and way is not None:
                said.append(
                    UnitQuestion(
                        f"{name} jumps from {here[at]:.5g} to {here[at + 1]:.5g} at {time_s[known[at + 1]]:g} s and "
                        f"stays there, as from {way}: does its unit change?"
                    )
                )
                break
    return said


def _differs_by(
    values: NDArray[np.float64],
    at: int,
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    factor: float,
    offset: float,
) -> bool:
    """Return True where the values after row `at` are those before it in another unit, at once and later."""
    pairs = ((values[at], values[at + 1]), (float(np.median(before)), float(np.median(after))))
    for old, new in pairs:
        expected = factor * old + offset
        if abs(new - expected) > SAME * abs(expected - old):
            return False
    return True


def _is_scaled(values: NDArray[np.float64], at: int, factor: float) -> bool:
    """Return True where all values after row `at` are apart from those before, and `factor` times some of these."""
    before, after = values[: at + 1], values[at + 1 :] / factor
    low, high = (1.0 - SAME) * float(before.min()), (1.0 + SAME) * float(before.max())
    apart = float((after * factor).max()) < before.min() if factor < 1.0 else before.max() < (after * factor).min()
    return low > 0.0 and bool(apart) and low <= after[0] <= high and low <= float(np.median(after)) <= high


def _longest_equal(values: NDArray[np.float64]) -> tuple[int, int] | None:
    """Return first and last place of equal values that no others of the column come near in length, or None."""
    known = np.flatnonzero(np.isfinite(values))
    here = values[known]
    if len(here) < 2 * LEAST_EQUAL:
        return None
    edges = np.flatnonzero(np.concatenate([[True], np.diff(here) != 0.0, [True]]))
    lengths = np.diff(edges)
    longest = int(np.argmax(lengths))
    count = int(lengths[longest])
    others = np.delete(lengths, longest)
    if count < LEAST_EQUAL or not len(others) or count < RARE * int(others.max()):
        return None
    elsewhere = len(here) - count
    if elsewhere < LEAST_EQUAL or len(others) < CHANGES * elsewhere:
        return None
    return int(known[edges[longest]]), int(known[edges[longest + 1] - 1])
