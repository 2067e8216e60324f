"""Units in the headings and in the cells of a record, as the suffixes that columns have.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.record.units.cells import without_cell_units
    from hil.record.units.headings import (
        fahrenheit_hint,
        name_and_unit,
        scaled_heading,
        suffixed,
        with_heading_units,
    )
    from hil.record.units.meanings import broken_sign, conversion, has_open_factor, looks_like_unit, meaning_of, unit_of
    from hil.record.units.unit_columns import row_units, unit_name, with_unit_columns

__all__ = [
    "broken_sign",
    "conversion",
    "fahrenheit_hint",
    "has_open_factor",
    "looks_like_unit",
    "meaning_of",
    "name_and_unit",
    "row_units",
    "scaled_heading",
    "suffixed",
    "unit_name",
    "unit_of",
    "with_heading_units",
    "with_unit_columns",
    "without_cell_units",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "cells": ("without_cell_units",),
        "headings": (
            "fahrenheit_hint",
            "name_and_unit",
            "scaled_heading",
            "suffixed",
            "with_heading_units",
        ),
        "meanings": ("broken_sign", "conversion", "has_open_factor", "looks_like_unit", "meaning_of", "unit_of"),
        "unit_columns": ("row_units", "unit_name", "with_unit_columns"),
    },
)
