"""Station of cooling towers: its files, its historian, and its aligned record.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.station.alignment import Aligned, align, iso
    from hil.tower.station.collection import Collected, collect
    from hil.tower.station.description import read_station
    from hil.tower.station.errors import TowerOutputError, writing
    from hil.tower.station.input_files import read_object, read_rows
    from hil.tower.station.record import (
        CellRecord,
        StationNotes,
        cells_of,
        event_entries,
        events_of,
        read_cell,
        read_channels,
        read_labels,
        read_notes,
        seconds,
        station_of,
    )

__all__ = [
    "Aligned",
    "CellRecord",
    "Collected",
    "StationNotes",
    "TowerOutputError",
    "align",
    "cells_of",
    "collect",
    "event_entries",
    "events_of",
    "iso",
    "read_cell",
    "read_channels",
    "read_labels",
    "read_notes",
    "read_object",
    "read_rows",
    "read_station",
    "seconds",
    "station_of",
    "writing",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "alignment": (
            "Aligned",
            "align",
            "iso",
        ),
        "collection": (
            "Collected",
            "collect",
        ),
        "description": ("read_station",),
        "errors": (
            "TowerOutputError",
            "writing",
        ),
        "input_files": (
            "read_object",
            "read_rows",
        ),
        "record": (
            "CellRecord",
            "StationNotes",
            "cells_of",
            "event_entries",
            "events_of",
            "read_cell",
            "read_channels",
            "read_labels",
            "read_notes",
            "seconds",
            "station_of",
        ),
    },
)
