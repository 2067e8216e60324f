"""CAN receiver and DBC files.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.can.bus import CanReceiver
    from drivers.can.dbc import DbcContents, DbcSignal, bind, describe_dbc, read_dbc
    from drivers.can.encoding import EncodedFrame, FrameEncoder
    from drivers.can.wire import CanWire

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "bus": ("CanReceiver",),
        "dbc": (
            "DbcContents",
            "DbcSignal",
            "bind",
            "describe_dbc",
            "read_dbc",
        ),
        "encoding": (
            "EncodedFrame",
            "FrameEncoder",
        ),
        "wire": ("CanWire",),
    },
)
