"""CAN receiver and DBC files.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.can.bus import CanReceiver
    from drivers.can.dbc import DbcContents, DbcSignal, bind, describe_dbc, read_dbc
    from drivers.can.encoding import EncodedFrame, FrameEncoder
    from drivers.can.wire import CanWire

_HOME = {
    "CanReceiver": "drivers.can.bus",
    "CanWire": "drivers.can.wire",
    "DbcContents": "drivers.can.dbc",
    "DbcSignal": "drivers.can.dbc",
    "EncodedFrame": "drivers.can.encoding",
    "FrameEncoder": "drivers.can.encoding",
    "bind": "drivers.can.dbc",
    "describe_dbc": "drivers.can.dbc",
    "read_dbc": "drivers.can.dbc",
}

__all__ = [
    "CanReceiver",
    "CanWire",
    "DbcContents",
    "DbcSignal",
    "EncodedFrame",
    "FrameEncoder",
    "bind",
    "describe_dbc",
    "read_dbc",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
