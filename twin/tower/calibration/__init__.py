"""Calibration of one cell over a record, and the baselines that it is compared with.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

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
    from twin.tower.calibration.conflicts import LabelConflict, label_conflicts, widened, with_lasting_errors
    from twin.tower.calibration.outlet_interval import NORMAL, QUANTILE, WET_C, WINDOW_S


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
    "with_lasting_errors",
    "without_discrepancy",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "baselines": ("BASELINES", "CellDataset", "split", "without_discrepancy"),
        "cell_fit": ("Calibrated", "CalibrationError", "FEWEST_BLOCKS", "Fitted", "fit_cell", "predict_cell"),
        "conflicts": ("LabelConflict", "label_conflicts", "widened", "with_lasting_errors"),
        "outlet_interval": ("NORMAL", "QUANTILE", "WET_C", "WINDOW_S"),
    },
)
