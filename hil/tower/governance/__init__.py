"""Governance of a calibration: gates, records, review queue, service, report.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.governance.calibration_folder import (
        continue_chains,
        is_of_calibration,
        require_same,
        sources_of,
        write_about,
    )
    from hil.tower.governance.events_file import read_events
    from hil.tower.governance.gates import Verdict
    from hil.tower.governance.network_service import NetworkGovernance
    from hil.tower.governance.records import CellLines, Indicators, append_records, drift_alarms
    from hil.tower.governance.report_page import REPORT, report
    from hil.tower.governance.service import CellGovernance, adopt_accepted, govern

__all__ = [
    "REPORT",
    "CellGovernance",
    "CellLines",
    "Indicators",
    "NetworkGovernance",
    "Verdict",
    "adopt_accepted",
    "append_records",
    "continue_chains",
    "drift_alarms",
    "govern",
    "is_of_calibration",
    "read_events",
    "report",
    "require_same",
    "sources_of",
    "write_about",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "calibration_folder": (
            "continue_chains",
            "is_of_calibration",
            "require_same",
            "sources_of",
            "write_about",
        ),
        "events_file": ("read_events",),
        "gates": ("Verdict",),
        "network_service": ("NetworkGovernance",),
        "records": (
            "CellLines",
            "Indicators",
            "append_records",
            "drift_alarms",
        ),
        "report_page": (
            "REPORT",
            "report",
        ),
        "service": (
            "CellGovernance",
            "adopt_accepted",
            "govern",
        ),
    },
)
