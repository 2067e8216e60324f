"""Drivers: rig files, signals, Modbus and CAN buses, historians, and the virtual rig.

The packages below are the interface; each names its own public objects. They are loaded on first use.
"""

from __future__ import annotations

from drivers.lazy_names import lazy_names

__all__ = ["bus", "can", "historian", "importers", "modbus", "rig", "rig_file", "signals", "virtual"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("bus", "can", "historian", "importers", "modbus", "rig", "rig_file", "signals", "virtual"),
    },
)
