"""Importers of rig files: vendor tables, Telegraf, Home Assistant, DBC files, described points.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

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
    from drivers.importers.settings import apply_settings
    from drivers.importers.telegraf import import_telegraf
    from drivers.importers.vendor_table import import_csv, names_registers


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
    "apply_settings",
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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "dbc": ("import_dbc",),
        "described": (
            "CAN",
            "Described",
            "DescribedActuator",
            "PLACE_SYNTAX",
            "SignalPlace",
            "actuator_of",
            "draft_of_description",
            "heartbeat_of",
            "place_of",
            "temperatures_of",
        ),
        "draft": ("Collector", "Draft", "DraftBus", "DraftPoint", "ImportFileError", "rig_file_text"),
        "homeassistant": ("import_homeassistant",),
        "settings": ("apply_settings",),
        "telegraf": ("import_telegraf",),
        "vendor_table.headings": ("names_registers",),
        "vendor_table.table": ("import_csv",),
    },
)
