"""Cooling tower: from a plant historian to a calibrated twin.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.align import Aligned, iso
    from hil.tower.align import align as align_station
    from hil.tower.calibrate import (
        DRIVEN,
        TABLE,
        CellResult,
        fit_with_steps,
        load_all,
        openings_of,
        priors_of,
        site_of,
        withheld,
        write_table,
    )
    from hil.tower.calibrate import calibrate as calibrate_station
    from hil.tower.collect import Collected
    from hil.tower.collect import collect as collect_points
    from hil.tower.commission import commission_cell, learn_healthy
    from hil.tower.diagnose import adopt, diagnose_station, document, write_document
    from hil.tower.errors import writing
    from hil.tower.governance import RECORDS, check_records
    from hil.tower.healthy import parse_span, path_beside, write_healthy
    from hil.tower.picture import draw_cell
    from hil.tower.plan import plan as plan_step_test
    from hil.tower.record import CellRecord, StationNotes, cells_of, read_cell, read_notes
    from hil.tower.report import REPORT
    from hil.tower.report import report as report_text
    from hil.tower.service import CellGovernance, govern
    from hil.tower.station import read_station
    from hil.tower.truth import Columns, compare, read_minutes, read_truth

__all__ = [
    "DRIVEN",
    "RECORDS",
    "REPORT",
    "TABLE",
    "Aligned",
    "CellGovernance",
    "CellRecord",
    "CellResult",
    "Collected",
    "Columns",
    "StationNotes",
    "adopt",
    "align_station",
    "calibrate_station",
    "cells_of",
    "check_records",
    "collect_points",
    "commission_cell",
    "compare",
    "diagnose_station",
    "document",
    "draw_cell",
    "fit_with_steps",
    "govern",
    "iso",
    "learn_healthy",
    "load_all",
    "openings_of",
    "parse_span",
    "path_beside",
    "plan_step_test",
    "priors_of",
    "read_cell",
    "read_minutes",
    "read_notes",
    "read_station",
    "read_truth",
    "report_text",
    "site_of",
    "withheld",
    "write_document",
    "write_healthy",
    "write_table",
    "writing",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "align": (
            "Aligned",
            "align_station = align",
            "iso",
        ),
        "calibrate": (
            "CellResult",
            "DRIVEN",
            "TABLE",
            "calibrate_station = calibrate",
            "fit_with_steps",
            "load_all",
            "openings_of",
            "priors_of",
            "site_of",
            "withheld",
            "write_table",
        ),
        "collect": (
            "Collected",
            "collect_points = collect",
        ),
        "commission": (
            "commission_cell",
            "learn_healthy",
        ),
        "diagnose": (
            "adopt",
            "diagnose_station",
            "document",
            "write_document",
        ),
        "errors": ("writing",),
        "governance": (
            "RECORDS",
            "check_records",
        ),
        "healthy": (
            "parse_span",
            "path_beside",
            "write_healthy",
        ),
        "picture": ("draw_cell",),
        "plan": ("plan_step_test = plan",),
        "record": (
            "CellRecord",
            "StationNotes",
            "cells_of",
            "read_cell",
            "read_notes",
        ),
        "report": (
            "REPORT",
            "report_text = report",
        ),
        "service": (
            "CellGovernance",
            "govern",
        ),
        "station": ("read_station",),
        "truth": (
            "Columns",
            "compare",
            "read_minutes",
            "read_truth",
        ),
    },
)
