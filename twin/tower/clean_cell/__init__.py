"""Clean cell: its commissioning, the discrepancy of its twin, and a check by Merkel's integral.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.tower.clean_cell.commissioning import CommissionedCell, CommissioningError, TestPoints, fit_clean_cell
    from twin.tower.clean_cell.discrepancy import FEATURES


__all__ = ["FEATURES", "CommissionedCell", "CommissioningError", "TestPoints", "fit_clean_cell"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "commissioning": ("CommissionedCell", "CommissioningError", "TestPoints", "fit_clean_cell"),
        "discrepancy": ("FEATURES",),
    },
)
