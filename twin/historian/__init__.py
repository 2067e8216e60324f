"""Records of a plant historian: tags, defects, minutes, regimes and events. Pure functions on arrays.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.historian.checks import FAN_APART
    from twin.historian.columns import OF_CELL, OF_STATION
    from twin.historian.events import INFLUENCE, Event, disturbed, influence_of
    from twin.historian.plausible import SITE_PRESSURE, exchanged_meters, in_usual_units, usual_at_work
    from twin.historian.ratings import Ratings
    from twin.historian.record import CellMinutes, cell_minutes, out_of_range, shared_minutes
    from twin.historian.regimes import START_UP_MIN, Regime, start_ups
    from twin.historian.stamps import order_and_silence, with_clock_steps_undone, without_strays
    from twin.historian.tags import Defect, Series, Tag
    from twin.historian.units import SPEEDS, UnitError, full_speed_of, unit_of


__all__ = [
    "FAN_APART",
    "INFLUENCE",
    "OF_CELL",
    "OF_STATION",
    "SITE_PRESSURE",
    "SPEEDS",
    "START_UP_MIN",
    "CellMinutes",
    "Defect",
    "Event",
    "Ratings",
    "Regime",
    "Series",
    "Tag",
    "UnitError",
    "cell_minutes",
    "disturbed",
    "exchanged_meters",
    "full_speed_of",
    "in_usual_units",
    "influence_of",
    "order_and_silence",
    "out_of_range",
    "shared_minutes",
    "start_ups",
    "unit_of",
    "usual_at_work",
    "with_clock_steps_undone",
    "without_strays",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "checks": ("FAN_APART",),
        "columns": ("OF_CELL", "OF_STATION"),
        "events": ("Event", "INFLUENCE", "disturbed", "influence_of"),
        "plausible": ("SITE_PRESSURE", "exchanged_meters", "in_usual_units", "usual_at_work"),
        "ratings": ("Ratings",),
        "record": ("CellMinutes", "cell_minutes", "out_of_range", "shared_minutes"),
        "regimes": ("Regime", "START_UP_MIN", "start_ups"),
        "stamps": ("order_and_silence", "with_clock_steps_undone", "without_strays"),
        "tags": ("Defect", "Series", "Tag"),
        "units": ("SPEEDS", "UnitError", "full_speed_of", "unit_of"),
    },
)
