"""Virtual rig: plant physics with a Modbus server, and a CAN node, in processes of their own.

The package is firmware: it imports neither a Modbus nor a CAN library, and nothing of the twin.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.rig import (
        PortInUseError,
        VirtualRig,
        VirtualRigError,
        VirtualRigOptions,
        serve,
        start_virtual_rig,
    )

_HOME = {
    "PortInUseError": "drivers.virtual.rig",
    "VirtualRig": "drivers.virtual.rig",
    "VirtualRigError": "drivers.virtual.rig",
    "VirtualRigOptions": "drivers.virtual.rig",
    "serve": "drivers.virtual.rig",
    "start_virtual_rig": "drivers.virtual.rig",
}

__all__ = [
    "PortInUseError",
    "VirtualRig",
    "VirtualRigError",
    "VirtualRigOptions",
    "serve",
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
