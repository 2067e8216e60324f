"""Virtual rig: plant physics with a Modbus server, and a CAN node, in processes of their own.

The package is firmware: it imports neither a Modbus nor a CAN library, and nothing of the twin.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.virtual.rig import (
        PortInUseError,
        VirtualRig,
        VirtualRigError,
        VirtualRigOptions,
        serve,
        start_virtual_rig,
    )


__all__ = [
    "PortInUseError",
    "VirtualRig",
    "VirtualRigError",
    "VirtualRigOptions",
    "serve",
    "start_virtual_rig",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "rig": ("PortInUseError", "VirtualRig", "VirtualRigError", "VirtualRigOptions", "serve", "start_virtual_rig"),
    },
)
