"""Lines of limits in the plots of a report: the levels of a bound, and the time for which it holds."""

from __future__ import annotations

from typing import Any

from hil.testing.bound_limits import BoundLimit
from hil.testing.limits import Bound, Compared, Settles

_AT_LEVEL = ("value", "max", "min", "mean", "percentile")
"""Measures in the unit and at the level of their signal."""


def line_of(bound: BoundLimit) -> dict[str, Any] | None:
    """Return columns, levels in the unit of the signal, and times in s of profile time; None for a limit without a
    level.
    """
    said = bound.statement
    levels: list[float] = []
    if isinstance(said, Compared) and said.measure in _AT_LEVEL:
        levels = _levels(said.bound)
    elif isinstance(said, Compared) and said.threshold is not None:
        levels = _levels(said.threshold)
    elif isinstance(said, Settles) and said.target is not None:
        target, band = said.target.number, said.band.number
        half = band * abs(target) / 100.0 if said.band.unit == "%" and bound.unit != "%" else band
        levels = [target - half, target + half]
    if not levels:
        return None
    return {"columns": list(bound.columns), "levels": levels, "from_s": bound.from_s, "to_s": bound.to_s}


def _levels(bound: Bound) -> list[float]:
    return [amount.number for amount in (bound.amount, bound.upper) if amount is not None]
