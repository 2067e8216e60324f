"""Units in the headings and in the cells of a record, as the suffixes that columns have.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.record.units.cells import without_cell_units
    from hil.record.units.headings import fahrenheit_hint, name_and_unit, suffixed, unit_of, with_heading_units

__all__ = ["fahrenheit_hint", "name_and_unit", "suffixed", "unit_of", "with_heading_units", "without_cell_units"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "cells": ("without_cell_units",),
        "headings": (
            "fahrenheit_hint",
            "name_and_unit",
            "suffixed",
            "unit_of",
            "with_heading_units",
        ),
    },
)
