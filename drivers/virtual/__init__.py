"""Virtual rig: plant physics with a Modbus server, and a CAN node, in processes of their own.

The package is firmware: it imports no Modbus library, and nothing of the twin.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

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
    from drivers.virtual.turns import taking_turns

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
    "taking_turns",
    "until_stopped",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "own_map": ("is_own_rig",),
        "processes": (
            "PortInUseError",
            "RunningRig",
            "VirtualRigError",
            "all_ready",
            "spawn",
            "stop_on_signals",
            "until_stopped",
        ),
        "rig": (
            "VirtualRig",
            "VirtualRigOptions",
            "serve",
            "start_virtual_rig",
        ),
        "turns": ("taking_turns",),
    },
)
