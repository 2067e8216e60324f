"""Limits as sentences: their grammar, their parsed form, and the units of their amounts.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.testing.limits.grammar import SentenceError, parse, parse_time
    from hil.testing.limits.statements import (
        TIMES_S,
        Amount,
        Bound,
        Compared,
        Follows,
        NoEffect,
        NoTrip,
        Sentence,
        Settles,
        Statement,
        Trips,
        TwinError,
        While,
        Window,
    )
    from hil.testing.limits.units import UnitError, difference_unit, factor_to

__all__ = [
    "TIMES_S",
    "Amount",
    "Bound",
    "Compared",
    "Follows",
    "NoEffect",
    "NoTrip",
    "Sentence",
    "SentenceError",
    "Settles",
    "Statement",
    "Trips",
    "TwinError",
    "UnitError",
    "While",
    "Window",
    "difference_unit",
    "factor_to",
    "parse",
    "parse_time",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "grammar": (
            "SentenceError",
            "parse",
            "parse_time",
        ),
        "statements": (
            "TIMES_S",
            "Amount",
            "Bound",
            "Compared",
            "Follows",
            "NoEffect",
            "NoTrip",
            "Sentence",
            "Settles",
            "Statement",
            "Trips",
            "TwinError",
            "While",
            "Window",
        ),
        "units": (
            "UnitError",
            "difference_unit",
            "factor_to",
        ),
    },
)
