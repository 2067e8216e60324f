"""Virtual rig: plant physics with a Modbus server, and a CAN node, in processes of their own.

The package is firmware: it imports no Modbus library, and nothing of the twin.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.own_map import is_own_rig
    from drivers.virtual.processes import (
        PortInUseError,
        RunningRig,
        VirtualRigError,
        all_ready,
        spawn,
        stop_on_signals,
        until_stopped,
    )
    from drivers.virtual.rig import VirtualRig, VirtualRigOptions, serve, start_virtual_rig

_HOME = {
    "PortInUseError": "drivers.virtual.processes",
    "RunningRig": "drivers.virtual.processes",
    "VirtualRig": "drivers.virtual.rig",
    "VirtualRigError": "drivers.virtual.processes",
    "VirtualRigOptions": "drivers.virtual.rig",
    "all_ready": "drivers.virtual.processes",
    "is_own_rig": "drivers.virtual.own_map",
    "serve": "drivers.virtual.rig",
    "spawn": "drivers.virtual.processes",
    "start_virtual_rig": "drivers.virtual.rig",
    "stop_on_signals": "drivers.virtual.processes",
    "until_stopped": "drivers.virtual.processes",
}

__all__ = [
    "PortInUseError",
    "RunningRig",
    "VirtualRig",
    "VirtualRigError",
    "VirtualRigOptions",
    "all_ready",
    "is_own_rig",
    "serve",
    "spawn",
    "start_virtual_rig",
    "stop_on_signals",
    "until_stopped",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
