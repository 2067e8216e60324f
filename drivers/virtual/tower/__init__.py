"""Virtual cooling-tower station: physics, operation, degradation, historian and device of a plant that no twin knows.

It shares no code and no formula with `twin`: Poppe's method in sectors, a fan curve against a resistance, own moist
air.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_HOME = {
    "state_by_minute": "drivers.virtual.tower.station",
    "Simulated": "drivers.virtual.tower.station",
    "StationDesign": "drivers.virtual.tower.sites",
    "MIAMI_SITE": "drivers.virtual.tower.sites",
    "CHICAGO_SITE": "drivers.virtual.tower.sites",
    "event_rows": "drivers.virtual.tower.export",
    "datasheet": "drivers.virtual.tower.export",
    "commissioning_rows": "drivers.virtual.tower.export",
    "COMMISSIONING": "drivers.virtual.tower.export",
    "STATION_FILES": "drivers.virtual.tower.export",
    "EFFECTS": "drivers.virtual.tower.effects",
    "DAYS_A_MONTH": "drivers.virtual.tower.station",
    "SimulationPlan": "drivers.virtual.tower.station",
    "Replay": "drivers.virtual.tower.device",
    "SITES": "drivers.virtual.tower.sites",
    "key_of": "drivers.virtual.tower.export",
    "load_station": "drivers.virtual.tower.device",
    "rig_text": "drivers.virtual.tower.device",
    "serve_station": "drivers.virtual.tower.device",
    "simulate": "drivers.virtual.tower.station",
    "write_dictionary": "drivers.virtual.tower.device",
    "with_defects": "drivers.virtual.tower.station",
    "write_station": "drivers.virtual.tower.export",
}

__all__ = [
    "CHICAGO_SITE",
    "COMMISSIONING",
    "DAYS_A_MONTH",
    "EFFECTS",
    "MIAMI_SITE",
    "SITES",
    "STATION_FILES",
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


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
