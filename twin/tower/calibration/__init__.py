"""Calibration of one cell over a record, and the baselines that it is compared with.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.tower.calibration.baselines import BASELINES, CellDataset, split, without_discrepancy
    from twin.tower.calibration.cell_fit import (
        FEWEST_BLOCKS,
        Calibrated,
        CalibrationError,
        Fitted,
        fit_cell,
        predict_cell,
    )
    from twin.tower.calibration.conflicts import LabelConflict, label_conflicts, widened
    from twin.tower.calibration.outlet_interval import NORMAL, QUANTILE, WET_C, WINDOW_S

_MODULES = {
    "baselines": (
        "BASELINES",
        "CellDataset",
        "split",
        "without_discrepancy",
    ),
    "cell_fit": (
        "FEWEST_BLOCKS",
        "Calibrated",
        "CalibrationError",
        "Fitted",
        "fit_cell",
        "predict_cell",
    ),
    "conflicts": (
        "LabelConflict",
        "label_conflicts",
        "widened",
    ),
    "outlet_interval": (
        "NORMAL",
        "QUANTILE",
        "WET_C",
        "WINDOW_S",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "BASELINES",
    "FEWEST_BLOCKS",
    "NORMAL",
    "QUANTILE",
    "WET_C",
    "WINDOW_S",
    "Calibrated",
    "CalibrationError",
    "CellDataset",
    "Fitted",
    "LabelConflict",
    "fit_cell",
    "label_conflicts",
    "predict_cell",
    "split",
    "widened",
    "without_discrepancy",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
