"""Virtual cooling-tower station: physics, operation, degradation, historian and device of a plant that no twin knows.

It shares no code and no formula with `twin`: Poppe's method in sectors, a fan curve against a resistance, own moist
air.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.virtual.tower.degradation import Ramp
    from drivers.virtual.tower.device import Replay, load_station, rig_text, serve_station, write_dictionary
    from drivers.virtual.tower.effects import EFFECTS
    from drivers.virtual.tower.export import (
        COMMISSIONING,
        STATION_FILES,
        commissioning_rows,
        datasheet,
        event_rows,
        key_of,
        write_station,
    )
    from drivers.virtual.tower.sites import CHICAGO_SITE, MIAMI_SITE, SITES, StationDesign
    from drivers.virtual.tower.station import (
        DAYS_A_MONTH,
        Simulated,
        SimulationPlan,
        simulate,
        state_by_minute,
        with_defects,
    )


__all__ = [
    "CHICAGO_SITE",
    "COMMISSIONING",
    "DAYS_A_MONTH",
    "EFFECTS",
    "MIAMI_SITE",
    "SITES",
    "STATION_FILES",
    "Ramp",
    "Replay",
    "Simulated",
    "SimulationPlan",
    "StationDesign",
    "commissioning_rows",
    "datasheet",
    "event_rows",
    "key_of",
    "load_station",
    "rig_text",
    "serve_station",
    "simulate",
    "state_by_minute",
    "with_defects",
    "write_dictionary",
    "write_station",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "degradation": ("Ramp",),
        "device": ("Replay", "load_station", "rig_text", "serve_station", "write_dictionary"),
        "effects": ("EFFECTS",),
        "export": (
            "COMMISSIONING",
            "STATION_FILES",
            "commissioning_rows",
            "datasheet",
            "event_rows",
            "key_of",
            "write_station",
        ),
        "sites": ("CHICAGO_SITE", "MIAMI_SITE", "SITES", "StationDesign"),
        "station": ("DAYS_A_MONTH", "Simulated", "SimulationPlan", "simulate", "state_by_minute", "with_defects"),
    },
)
