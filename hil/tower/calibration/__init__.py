"""Calibration of a station's cells: commissioning, healthy record, calibration, comparison with the truth.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.calibration.calibrated_table import TABLE, informed, read_remarks, write_table
    from hil.tower.calibration.commission import commission_cell, learn_healthy, read_points
    from hil.tower.calibration.healthy import Healthy, healthy_of, parse_span, path_beside, write_healthy
    from hil.tower.calibration.picture import FOUND, draw_cell
    from hil.tower.calibration.prepared_cells import (
        PreparedCell,
        load_all,
        openings_of,
        prepare_cells,
        priors_of,
        site_of,
    )
    from hil.tower.calibration.remarks import conflict_sentence, contradiction_sentence, remarks_of, step_sentence
    from hil.tower.calibration.station_fit import (
        DRIVEN,
        CellResult,
        calibrate,
        fit_with_steps,
        undeclared_jumps,
    )
    from hil.tower.calibration.truth import TruthColumns, compare, read_minutes, read_truth

__all__ = [
    "DRIVEN",
    "FOUND",
    "TABLE",
    "CellResult",
    "Healthy",
    "PreparedCell",
    "TruthColumns",
    "calibrate",
    "commission_cell",
    "compare",
    "conflict_sentence",
    "contradiction_sentence",
    "draw_cell",
    "fit_with_steps",
    "healthy_of",
    "informed",
    "learn_healthy",
    "load_all",
    "openings_of",
    "parse_span",
    "path_beside",
    "prepare_cells",
    "priors_of",
    "read_minutes",
    "read_points",
    "read_remarks",
    "read_truth",
    "remarks_of",
    "site_of",
    "step_sentence",
    "undeclared_jumps",
    "write_healthy",
    "write_table",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "commission": (
            "commission_cell",
            "learn_healthy",
            "read_points",
        ),
        "healthy": (
            "Healthy",
            "healthy_of",
            "parse_span",
            "path_beside",
            "write_healthy",
        ),
        "picture": ("FOUND", "draw_cell"),
        "calibrated_table": ("TABLE", "informed", "read_remarks", "write_table"),
        "remarks": ("conflict_sentence", "contradiction_sentence", "remarks_of", "step_sentence"),
        "prepared_cells": ("PreparedCell", "load_all", "openings_of", "prepare_cells", "priors_of", "site_of"),
        "station_fit": ("CellResult", "DRIVEN", "calibrate", "fit_with_steps", "undeclared_jumps"),
        "truth": (
            "TruthColumns",
            "compare",
            "read_minutes",
            "read_truth",
        ),
    },
)
