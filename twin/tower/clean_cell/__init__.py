"""Clean cell: its commissioning, the discrepancy of its twin, and a check by Merkel's integral.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.tower.clean_cell.commissioning import CommissionedCell, CommissioningError, TestPoints, fit_clean_cell
    from twin.tower.clean_cell.discrepancy import FEATURES

_MODULES = {
    "commissioning": (
        "CommissionedCell",
        "CommissioningError",
        "TestPoints",
        "fit_clean_cell",
    ),
    "discrepancy": ("FEATURES",),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = ["FEATURES", "CommissionedCell", "CommissioningError", "TestPoints", "fit_clean_cell"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
