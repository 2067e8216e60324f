"""Governance of a calibration: gates, records, review queue, service, report.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.governance.network_service import NetworkGovernance
    from hil.tower.governance.records import NETWORK_RECORDS, RECORDS, Indicators, check_records, drift_alarms
    from hil.tower.governance.report_page import REPORT, report
    from hil.tower.governance.service import CellGovernance, govern

__all__ = [
    "NETWORK_RECORDS",
    "RECORDS",
    "REPORT",
    "CellGovernance",
    "Indicators",
    "NetworkGovernance",
    "check_records",
    "drift_alarms",
    "govern",
    "report",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "network_service": ("NetworkGovernance",),
        "records": (
            "Indicators",
            "NETWORK_RECORDS",
            "RECORDS",
            "check_records",
            "drift_alarms",
        ),
        "report_page": (
            "REPORT",
            "report",
        ),
        "service": (
            "CellGovernance",
            "govern",
        ),
    },
)
