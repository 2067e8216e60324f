"""Cooling tower: from a plant historian to a calibrated twin.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.calibration import (
        DRIVEN,
        TABLE,
        CellResult,
        TruthColumns,
        commission_cell,
        compare,
        draw_cell,
        fit_with_steps,
        learn_healthy,
        load_all,
        openings_of,
        parse_span,
        path_beside,
        priors_of,
        read_minutes,
        read_truth,
        site_of,
        withheld,
        write_healthy,
        write_table,
    )
    from hil.tower.calibration import calibrate as calibrate_station
    from hil.tower.diagnose import adopt, diagnose_station, document, write_document
    from hil.tower.governance import (
        NETWORK_RECORDS,
        RECORDS,
        REPORT,
        CellGovernance,
        NetworkGovernance,
        check_records,
        govern,
    )
    from hil.tower.governance import report as report_text
    from hil.tower.network import (
        NETWORK_TABLE,
        NetworkMode,
        StationAnswers,
        ask_network,
        check_network,
        write_network_table,
    )
    from hil.tower.network import remove_table as remove_network_table
    from hil.tower.plan import plan as plan_step_test
    from hil.tower.station import (
        Aligned,
        CellRecord,
        Collected,
        StationNotes,
        cells_of,
        events_of,
        iso,
        read_cell,
        read_notes,
        read_station,
        writing,
    )
    from hil.tower.station import align as align_station
    from hil.tower.station import collect as collect_points

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
        "calibration.calibrated_table": ("TABLE", "withheld", "write_table"),
        "calibration.prepared_cells": ("load_all", "openings_of", "priors_of", "site_of"),
        "calibration.station_fit": ("CellResult", "DRIVEN", "calibrate_station = calibrate", "fit_with_steps"),
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
