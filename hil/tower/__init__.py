"""Cooling tower: from a plant historian to a calibrated twin.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.calibration.commission import commission_cell, learn_healthy
    from hil.tower.calibration.healthy import parse_span, path_beside, write_healthy
    from hil.tower.calibration.picture import draw_cell
    from hil.tower.calibration.station_fit import (
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
    from hil.tower.calibration.station_fit import calibrate as calibrate_station
    from hil.tower.calibration.truth import TruthColumns, compare, read_minutes, read_truth
    from hil.tower.diagnose import adopt, diagnose_station, document, write_document
    from hil.tower.governance.network_service import NetworkGovernance
    from hil.tower.governance.records import NETWORK_RECORDS, RECORDS, check_records
    from hil.tower.governance.report_page import REPORT
    from hil.tower.governance.report_page import report as report_text
    from hil.tower.governance.service import CellGovernance, govern
    from hil.tower.network.answers import NetworkMode, StationAnswers, ask_network, check_network
    from hil.tower.network.table_file import NETWORK_TABLE, write_network_table
    from hil.tower.network.table_file import remove_table as remove_network_table
    from hil.tower.plan import plan as plan_step_test
    from hil.tower.station.alignment import Aligned, iso
    from hil.tower.station.alignment import align as align_station
    from hil.tower.station.collection import Collected
    from hil.tower.station.collection import collect as collect_points
    from hil.tower.station.description import read_station
    from hil.tower.station.errors import writing
    from hil.tower.station.record import CellRecord, StationNotes, cells_of, events_of, read_cell, read_notes

__all__ = [
    "DRIVEN",
    "NETWORK_RECORDS",
    "NETWORK_TABLE",
    "RECORDS",
    "REPORT",
    "TABLE",
    "Aligned",
    "CellGovernance",
    "CellRecord",
    "CellResult",
    "Collected",
    "NetworkGovernance",
    "NetworkMode",
    "StationAnswers",
    "StationNotes",
    "TruthColumns",
    "adopt",
    "align_station",
    "ask_network",
    "calibrate_station",
    "cells_of",
    "check_network",
    "check_records",
    "collect_points",
    "commission_cell",
    "compare",
    "diagnose_station",
    "document",
    "draw_cell",
    "events_of",
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
    "remove_network_table",
    "report_text",
    "site_of",
    "withheld",
    "write_document",
    "write_healthy",
    "write_network_table",
    "write_table",
    "writing",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "station.alignment": (
            "Aligned",
            "align_station = align",
            "iso",
        ),
        "calibration.station_fit": (
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
        "station.collection": (
            "Collected",
            "collect_points = collect",
        ),
        "calibration.commission": (
            "commission_cell",
            "learn_healthy",
        ),
        "diagnose": (
            "adopt",
            "diagnose_station",
            "document",
            "write_document",
        ),
        "station.errors": ("writing",),
        "governance.network_service": ("NetworkGovernance",),
        "governance.records": (
            "NETWORK_RECORDS",
            "RECORDS",
            "check_records",
        ),
        "calibration.healthy": (
            "parse_span",
            "path_beside",
            "write_healthy",
        ),
        "calibration.picture": ("draw_cell",),
        "network.answers": (
            "NetworkMode",
            "StationAnswers",
            "ask_network",
            "check_network",
        ),
        "network.table_file": (
            "NETWORK_TABLE",
            "remove_network_table = remove_table",
            "write_network_table",
        ),
        "plan": ("plan_step_test = plan",),
        "station.record": (
            "CellRecord",
            "StationNotes",
            "cells_of",
            "events_of",
            "read_cell",
            "read_notes",
        ),
        "governance.report_page": (
            "REPORT",
            "report_text = report",
        ),
        "governance.service": (
            "CellGovernance",
            "govern",
        ),
        "station.description": ("read_station",),
        "calibration.truth": (
            "TruthColumns",
            "compare",
            "read_minutes",
            "read_truth",
        ),
    },
)
