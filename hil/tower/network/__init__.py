"""Network calibrator on the record of a station: windows of its cells, the ensemble's answers, and their table.

The names below are the package's interface; they are loaded on first use. Asking a network needs the extra ``ml``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.network.answers import (
        NETWORK,
        NetworkAnswers,
        NetworkMode,
        StationAnswers,
        ask_network,
        check_network,
    )
    from hil.tower.network.table_file import NETWORK_TABLE, read_about, write_network_table

__all__ = [
    "NETWORK",
    "NETWORK_TABLE",
    "NetworkAnswers",
    "NetworkMode",
    "StationAnswers",
    "ask_network",
    "check_network",
    "read_about",
    "write_network_table",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "answers": ("NETWORK", "NetworkAnswers", "NetworkMode", "StationAnswers", "ask_network", "check_network"),
        "table_file": ("NETWORK_TABLE", "read_about", "write_network_table"),
    },
)
