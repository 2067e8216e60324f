"""Modbus protocol without I/O: PDUs, frames, matching of replies.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.modbus.protocol.frames import RtuFrames, TcpFrames, frames_of
    from drivers.modbus.protocol.pdu import (
        BUSY,
        GATEWAY_SILENCE,
        NO_SUCH_ADDRESS,
        NO_SUCH_FUNCTION,
        OF_CONTENT,
        Read,
        ReadBack,
        check_written,
        write_request,
    )
    from drivers.modbus.protocol.pymodbus_codec import rtu_frame
    from drivers.modbus.protocol.replies import FrameGuard
    from drivers.modbus.protocol.reply_offset import OpenRequests
    from drivers.modbus.protocol.rtu import RtuGuard

_HOME = {
    "BUSY": "drivers.modbus.protocol.pdu",
    "FrameGuard": "drivers.modbus.protocol.replies",
    "GATEWAY_SILENCE": "drivers.modbus.protocol.pdu",
    "NO_SUCH_ADDRESS": "drivers.modbus.protocol.pdu",
    "NO_SUCH_FUNCTION": "drivers.modbus.protocol.pdu",
    "OF_CONTENT": "drivers.modbus.protocol.pdu",
    "OpenRequests": "drivers.modbus.protocol.reply_offset",
    "Read": "drivers.modbus.protocol.pdu",
    "ReadBack": "drivers.modbus.protocol.pdu",
    "RtuFrames": "drivers.modbus.protocol.frames",
    "RtuGuard": "drivers.modbus.protocol.rtu",
    "TcpFrames": "drivers.modbus.protocol.frames",
    "check_written": "drivers.modbus.protocol.pdu",
    "frames_of": "drivers.modbus.protocol.frames",
    "rtu_frame": "drivers.modbus.protocol.pymodbus_codec",
    "write_request": "drivers.modbus.protocol.pdu",
}

__all__ = [
    "BUSY",
    "GATEWAY_SILENCE",
    "NO_SUCH_ADDRESS",
    "NO_SUCH_FUNCTION",
    "OF_CONTENT",
    "FrameGuard",
    "OpenRequests",
    "Read",
    "ReadBack",
    "RtuFrames",
    "RtuGuard",
    "TcpFrames",
    "check_written",
    "frames_of",
    "rtu_frame",
    "write_request",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
