"""Faulty links and replies on request.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.virtual.faults.faulty_link import (
        Change,
        FaultyLink,
        as_it_comes,
        can_frames,
        modbus_frames,
        rtu_frames,
    )


__all__ = [
    "Change",
    "FaultyLink",
    "as_it_comes",
    "can_frames",
    "modbus_frames",
    "rtu_frames",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "faulty_link": ("Change", "FaultyLink", "as_it_comes", "can_frames", "modbus_frames", "rtu_frames"),
    },
)
