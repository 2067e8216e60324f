"""Frames around requests, and the replies found in what arrives: Modbus/TCP and RTU behind one form."""

from __future__ import annotations

import struct

from drivers.bus_sections import ModbusBusSection, is_rtu
from drivers.replies import FrameGuard
from drivers.rtu import RtuGuard, frame_of

_HEADER = struct.Struct(">HHHB")


class TcpFrames:
    """MBAP frames (Modbus messaging on TCP/IP implementation guide V1.0b, 3.1.3)."""

    def __init__(self) -> None:
        self._guard = FrameGuard()
        self._transaction = 0

    def frame(self, device: int, pdu: bytes) -> bytes:
        """Frame of a request."""
        self._transaction = self._transaction % 65535 + 1
        return _HEADER.pack(self._transaction, 0, len(pdu) + 1, device) + pdu

    def feed(self, data: bytes, device: int, pdu: bytes) -> bytes | None:
        """PDU of the reply to that request, once it is whole; raises ProtocolError."""
        frames = self._guard.feed(data, self._transaction, device)
        return frames[0][_HEADER.size :] if frames else None

    @property
    def dropped(self) -> int:
        """Whole frames that were no answer to the request."""
        return self._guard.dropped


class RtuFrames:
    """RTU frames (Modbus over serial line V1.02, 2.5.1)."""

    def __init__(self) -> None:
        self._guard = RtuGuard()

    def frame(self, device: int, pdu: bytes) -> bytes:
        """Frame of a request."""
        self._guard.clear()
        return frame_of(device, pdu)

    def feed(self, data: bytes, device: int, pdu: bytes) -> bytes | None:
        """PDU of the reply to that request, once it is whole; raises ProtocolError."""
        passed = self._guard.feed(data, device, pdu)
        return passed[0] if passed else None

    @property
    def dropped(self) -> int:
        """Whole frames that were no answer to the request."""
        return self._guard.dropped


def frames_of(config: ModbusBusSection) -> TcpFrames | RtuFrames:
    """Frames of a bus, at the beginning of a connection."""
    return RtuFrames() if is_rtu(config) else TcpFrames()
