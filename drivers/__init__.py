"""Drivers: rig files, signals, Modbus and CAN buses, and the virtual rig.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.rig.connection import RigConnection
    from drivers.rig.watch import RigWatch
    from drivers.rig_file.model import Point, Rig
    from drivers.rig_file.reader import RigFileError, load_rig
    from drivers.signals.points import DriverError, Quality, Signal, Snapshot
    from drivers.virtual.rig import VirtualRig, start_virtual_rig

_HOME = {
    "DriverError": "drivers.signals.points",
    "Point": "drivers.rig_file.model",
    "Quality": "drivers.signals.points",
    "Rig": "drivers.rig_file.model",
    "RigConnection": "drivers.rig.connection",
    "RigFileError": "drivers.rig_file.reader",
    "RigWatch": "drivers.rig.watch",
    "Signal": "drivers.signals.points",
    "Snapshot": "drivers.signals.points",
    "VirtualRig": "drivers.virtual.rig",
    "load_rig": "drivers.rig_file.reader",
    "start_virtual_rig": "drivers.virtual.rig",
}

__all__ = [
    "DriverError",
    "Point",
    "Quality",
    "Rig",
    "RigConnection",
    "RigFileError",
    "RigWatch",
    "Signal",
    "Snapshot",
    "VirtualRig",
    "load_rig",
    "start_virtual_rig",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
