"""Modbus protocol without I/O: PDUs, frames, matching of replies.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "frames": ("RtuFrames", "TcpFrames", "frames_of"),
        "pdu": (
            "BUSY",
            "GATEWAY_SILENCE",
            "NO_SUCH_ADDRESS",
            "NO_SUCH_FUNCTION",
            "OF_CONTENT",
            "Read",
            "ReadBack",
            "check_written",
            "write_request",
        ),
        "pymodbus_codec": ("rtu_frame",),
        "replies": ("FrameGuard",),
        "reply_offset": ("OpenRequests",),
        "rtu": ("RtuGuard",),
    },
)
