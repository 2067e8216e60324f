"""Faulty links and replies on request.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.faults.faulty_link import (
        Change,
        FaultyLink,
        as_it_comes,
        can_frames,
        modbus_frames,
        rtu_frames,
    )

_HOME = {
    "Change": "drivers.virtual.faults.faulty_link",
    "FaultyLink": "drivers.virtual.faults.faulty_link",
    "as_it_comes": "drivers.virtual.faults.faulty_link",
    "can_frames": "drivers.virtual.faults.faulty_link",
    "modbus_frames": "drivers.virtual.faults.faulty_link",
    "rtu_frames": "drivers.virtual.faults.faulty_link",
}

__all__ = [
    "Change",
    "FaultyLink",
    "as_it_comes",
    "can_frames",
    "modbus_frames",
    "rtu_frames",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
