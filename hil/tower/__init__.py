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
        informed,
        learn_healthy,
        load_all,
        openings_of,
        parse_span,
        path_beside,
        priors_of,
        read_minutes,
        read_remarks,
        read_truth,
        site_of,
        step_sentence,
        write_healthy,
        write_table,
    )
    from hil.tower.calibration import calibrate as calibrate_station
    from hil.tower.check import CheckedFile, check_file
    from hil.tower.diagnose import adopt, diagnose_station, document, write_document
    from hil.tower.file_kinds import cells_of, tower_kind
    from hil.tower.governance import (
        REPORT,
        CellGovernance,
        CellLines,
        NetworkGovernance,
        Verdict,
        adopt_accepted,
        append_records,
        continue_chains,
        govern,
        is_of_calibration,
        read_events,
        require_same,
        sources_of,
        write_about,
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
    from hil.tower.plan import plan as plan_step_test
    from hil.tower.station import (
        Aligned,
        CellRecord,
        Collected,
        StationNotes,
        TowerOutputError,
        iso,
        open_samples,
        read_cell,
        read_notes,
        read_station,
        seconds,
        unused_labels,
        writing,
    )
    from hil.tower.station import align as align_station
    from hil.tower.station import collect as collect_points

__all__ = [
    "DRIVEN",
    "NETWORK_TABLE",
    "REPORT",
    "TABLE",
    "Aligned",
    "CellGovernance",
    "CellLines",
    "CellRecord",
    "CellResult",
    "CheckedFile",
    "Collected",
    "NetworkGovernance",
    "NetworkMode",
    "StationAnswers",
    "StationNotes",
    "TowerOutputError",
    "TruthColumns",
    "Verdict",
    "adopt",
    "adopt_accepted",
    "align_station",
    "append_records",
    "ask_network",
    "calibrate_station",
    "cells_of",
    "check_file",
    "check_network",
    "collect_points",
    "commission_cell",
    "compare",
    "continue_chains",
    "diagnose_station",
    "document",
    "draw_cell",
    "fit_with_steps",
    "govern",
    "informed",
    "is_of_calibration",
    "iso",
    "learn_healthy",
    "load_all",
    "open_samples",
    "openings_of",
    "parse_span",
    "path_beside",
    "plan_step_test",
    "priors_of",
    "read_cell",
    "read_events",
    "read_minutes",
    "read_notes",
    "read_remarks",
    "read_station",
    "read_truth",
    "report_text",
    "require_same",
    "seconds",
    "site_of",
    "sources_of",
    "step_sentence",
    "tower_kind",
    "unused_labels",
    "write_about",
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
        ),
        "calibration.calibrated_table": ("TABLE", "informed", "read_remarks", "write_table"),
        "calibration.remarks": ("step_sentence",),
        "station.times": ("iso", "seconds"),
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
        "check": ("CheckedFile", "check_file"),
        "file_kinds": (
            "cells_of",
            "tower_kind",
        ),
        "diagnose": (
            "adopt",
            "diagnose_station",
            "document",
            "write_document",
        ),
        "station.errors": ("TowerOutputError", "writing"),
        "governance.gates": ("Verdict",),
        "governance.network_service": ("NetworkGovernance",),
        "governance.records": ("CellLines", "append_records"),
        "governance.calibration_folder": (
            "continue_chains",
            "is_of_calibration",
            "require_same",
            "sources_of",
            "write_about",
        ),
        "governance.events_file": ("read_events",),
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
            "write_network_table",
        ),
        "plan": ("plan_step_test = plan",),
        "station.record": (
            "CellRecord",
            "StationNotes",
            "read_cell",
            "read_notes",
            "unused_labels",
        ),
        "governance.report_page": (
            "REPORT",
            "report_text = report",
        ),
        "governance.service": (
            "CellGovernance",
            "adopt_accepted",
            "govern",
        ),
        "station.csv_store": ("open_samples",),
        "station.description": ("read_station",),
        "calibration.truth": (
            "TruthColumns",
            "compare",
            "read_minutes",
            "read_truth",
        ),
    },
)
