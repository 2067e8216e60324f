"""Time axis of a record in seconds.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.record.times.columns import find_columns, holds_moments
    from hil.record.times.names import SECONDS_PER, is_time_name, names_dates, names_unit, seconds_per_unit
    from hil.record.times.seconds import read_seconds
    from hil.record.times.time_axis import GAP_PERIODS, TimeAxis, numbered, read_time, span
    from hil.record.times.wall_clock import TimeTextError
    from hil.record.times.zones import zone_of

__all__ = [
    "GAP_PERIODS",
    "SECONDS_PER",
    "TimeAxis",
    "TimeTextError",
    "find_columns",
    "holds_moments",
    "is_time_name",
    "names_dates",
    "names_unit",
    "numbered",
    "read_seconds",
    "read_time",
    "seconds_per_unit",
    "span",
    "zone_of",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "columns": ("find_columns", "holds_moments"),
        "names": (
            "SECONDS_PER",
            "is_time_name",
            "names_dates",
            "names_unit",
            "seconds_per_unit",
        ),
        "seconds": ("read_seconds",),
        "time_axis": (
            "GAP_PERIODS",
            "TimeAxis",
            "numbered",
            "read_time",
            "span",
        ),
        "wall_clock": ("TimeTextError",),
        "zones": ("zone_of",),
    },
)
