"""Cells of a record as numbers with a unit.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.record.values.numbers import (
        LOST,
        MARKS,
        MISSING,
        DecimalSignError,
        Numbers,
        Sign,
        decimal_signs,
        evidence_of,
        may_be_lost,
        parse,
        readings,
        trimmed,
    )
    from hil.record.values.question import UnitQuestion, open_questions
    from hil.record.values.steady import standing_still, unit_jumps
    from hil.record.values.units import COLDEST_K, beyond_declared, is_difference, of_a_room, remarks

__all__ = [
    "COLDEST_K",
    "LOST",
    "MARKS",
    "MISSING",
    "DecimalSignError",
    "Numbers",
    "Sign",
    "UnitQuestion",
    "beyond_declared",
    "decimal_signs",
    "evidence_of",
    "is_difference",
    "may_be_lost",
    "of_a_room",
    "open_questions",
    "parse",
    "readings",
    "remarks",
    "standing_still",
    "trimmed",
    "unit_jumps",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "numbers": (
            "DecimalSignError",
            "LOST",
            "MARKS",
            "MISSING",
            "Numbers",
            "Sign",
            "decimal_signs",
            "evidence_of",
            "may_be_lost",
            "parse",
            "readings",
            "trimmed",
        ),
        "question": ("UnitQuestion", "open_questions"),
        "steady": ("standing_still", "unit_jumps"),
        "units": (
            "COLDEST_K",
            "beyond_declared",
            "is_difference",
            "of_a_room",
            "remarks",
        ),
    },
)
