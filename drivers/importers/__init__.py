"""Importers of rig files: vendor tables, Telegraf, Home Assistant, DBC files, described points.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.importers.dbc import import_dbc
    from drivers.importers.described import (
        CAN,
        PLACE_SYNTAX,
        Described,
        DescribedActuator,
        SignalPlace,
        actuator_of,
        draft_of_description,
        heartbeat_of,
        place_of,
        temperatures_of,
    )
    from drivers.importers.draft import Collector, Draft, DraftBus, DraftPoint, ImportFileError, rig_file_text
    from drivers.importers.homeassistant import import_homeassistant
    from drivers.importers.telegraf import import_telegraf
    from drivers.importers.vendor_table import import_csv, names_registers

_HOME = {
    "DescribedActuator": "drivers.importers.described",
    "CAN": "drivers.importers.described",
    "Collector": "drivers.importers.draft",
    "Described": "drivers.importers.described",
    "Draft": "drivers.importers.draft",
    "DraftBus": "drivers.importers.draft",
    "DraftPoint": "drivers.importers.draft",
    "ImportFileError": "drivers.importers.draft",
    "PLACE_SYNTAX": "drivers.importers.described",
    "SignalPlace": "drivers.importers.described",
    "actuator_of": "drivers.importers.described",
    "draft_of_description": "drivers.importers.described",
    "heartbeat_of": "drivers.importers.described",
    "import_csv": "drivers.importers.vendor_table.table",
    "import_dbc": "drivers.importers.dbc",
    "import_homeassistant": "drivers.importers.homeassistant",
    "import_telegraf": "drivers.importers.telegraf",
    "names_registers": "drivers.importers.vendor_table.headings",
    "place_of": "drivers.importers.described",
    "rig_file_text": "drivers.importers.draft",
    "temperatures_of": "drivers.importers.described",
}

__all__ = [
    "CAN",
    "PLACE_SYNTAX",
    "Collector",
    "Described",
    "DescribedActuator",
    "Draft",
    "DraftBus",
    "DraftPoint",
    "ImportFileError",
    "SignalPlace",
    "actuator_of",
    "draft_of_description",
    "heartbeat_of",
    "import_csv",
    "import_dbc",
    "import_homeassistant",
    "import_telegraf",
    "names_registers",
    "place_of",
    "rig_file_text",
    "temperatures_of",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
