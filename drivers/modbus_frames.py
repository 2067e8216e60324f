"""Frames around requests, and the replies found in what arrives: Modbus/TCP and RTU behind one form."""

from __future__ import annotations

import struct

from drivers.bus_sections import ModbusBusSection, is_numbered, is_rtu
from drivers.points import ProtocolError
from drivers.replies import FrameGuard, answers
from drivers.rtu import RtuGuard, frame_of

_HEADER = struct.Struct(">HHHB")


class TcpFrames:
    """MBAP frames (Modbus messaging on TCP/IP implementation guide V1.0b, 3.1.3).

    `numbered` is False of a device that answers with transaction 0: a reply is then known by its form alone.
    """

    def __init__(self, *, numbered: bool = True) -> None:
        self._guard = FrameGuard(takes_zero=not numbered)
        self._numbered = numbered
        self._transaction = 0

    def frame(self, device: int, pdu: bytes) -> bytes:
        """Frame of a request."""
        if not self._numbered:
            self._guard.clear()
        self._transaction = self._transaction % 65535 + 1
        return _HEADER.pack(self._transaction, 0, len(pdu) + 1, device) + pdu

    def feed(self, data: bytes, device: int, pdu: bytes) -> bytes | None:
        """PDU of the reply to that request, once it is whole; raises ProtocolError."""
        frames = self._guard.feed(data, self._transaction, device)
        if self._numbered or not frames:
            return frames[0][_HEADER.size :] if frames else None
        if len(frames) > 1 or self._guard.holds:
            raise ProtocolError("more than one reply to one request: which is ours is not known")
        reply = frames[0][_HEADER.size :]
        if not answers(reply, pdu):
            raise ProtocolError("a reply to another request")
        return reply

    @property
    def unused(self) -> str | None:
        """What came and was no answer to the request, in words."""
        if not self._guard.dropped:
            return None
        zero = "; it answers with transaction 0: give transaction = 'zero' where it always does"
        return _counted(self._guard.dropped) + (zero if self._guard.zeros else "")


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
    def unused(self) -> str | None:
        """What came and was no answer to the request, in words."""
        return _counted(self._guard.dropped) if self._guard.dropped else None


def _counted(dropped: int) -> str:
    return f"{dropped} replies to another request or of another unit were not used"


def frames_of(config: ModbusBusSection) -> TcpFrames | RtuFrames:
    """Frames of a bus, at the beginning of a connection."""
    return RtuFrames() if is_rtu(config) else TcpFrames(numbered=is_numbered(config))
