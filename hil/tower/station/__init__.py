"""Station of cooling towers: its files, its historian, and its aligned record.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tower.station.alignment import Aligned, align, surveyed
    from hil.tower.station.collection import Collected, collect
    from hil.tower.station.csv_store import open_samples
    from hil.tower.station.description import Station, checked_datasheet, read_station
    from hil.tower.station.errors import Mistakes, TableError, TowerOutputError, writing
    from hil.tower.station.input_files import read_datasheet, read_object, read_rows
    from hil.tower.station.json_shape import misfit
    from hil.tower.station.record import (
        EVENT_SHAPE,
        CellRecord,
        StationNotes,
        event_entries,
        events_of,
        read_cell,
        read_channels,
        read_labels,
        read_notes,
        span_of,
        station_of,
        timed_events,
        unused_labels,
    )
    from hil.tower.station.times import iso, seconds

__all__ = [
    "EVENT_SHAPE",
    "Aligned",
    "CellRecord",
    "Collected",
    "Mistakes",
    "Station",
    "StationNotes",
    "TableError",
    "TowerOutputError",
    "align",
    "checked_datasheet",
    "collect",
    "event_entries",
    "events_of",
    "iso",
    "misfit",
    "open_samples",
    "read_cell",
    "read_channels",
    "read_datasheet",
    "read_labels",
    "read_notes",
    "read_object",
    "read_rows",
    "read_station",
    "seconds",
    "span_of",
    "station_of",
    "surveyed",
    "timed_events",
    "unused_labels",
    "writing",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "alignment": (
            "Aligned",
            "align",
            "surveyed",
        ),
        "collection": (
            "Collected",
            "collect",
        ),
        "csv_store": ("open_samples",),
        "description": ("Station", "checked_datasheet", "read_station"),
        "errors": (
            "Mistakes",
            "TableError",
            "TowerOutputError",
            "writing",
        ),
        "input_files": (
            "read_datasheet",
            "read_object",
            "read_rows",
        ),
        "json_shape": ("misfit",),
        "record": (
            "EVENT_SHAPE",
            "CellRecord",
            "StationNotes",
            "event_entries",
            "events_of",
            "read_cell",
            "read_channels",
            "read_labels",
            "read_notes",
            "span_of",
            "station_of",
            "timed_events",
            "unused_labels",
        ),
        "times": ("iso", "seconds"),
    },
)
