"""Frames around requests, and the replies found in what arrives: Modbus/TCP and RTU behind one form."""

from __future__ import annotations

from drivers.modbus.protocol.pymodbus_codec import rtu_frame, tcp_frame
from drivers.modbus.protocol.replies import FrameGuard, answers
from drivers.modbus.protocol.reply_defects import HEADER, is_tcp_frame, service_of
from drivers.modbus.protocol.rtu import RtuGuard
from drivers.rig_file import ModbusBusSection, ModbusTcpBus, is_numbered, is_rtu
from drivers.signals import ProtocolError

_TRANSACTIONS = 65535
"""Transaction numbers, 1 to 65535, after which they begin anew."""


class TcpFrames:
    """MBAP frames (Modbus messaging on TCP/IP implementation guide V1.0b, 3.1.3).

    `numbered` is False of a device that answers with transaction 0: a reply is then known by its form alone. With
    `by_content` the length in a reply's header does not count.
    """

    def __init__(self, *, numbered: bool = True, by_content: bool = False) -> None:
        self._guard = FrameGuard(takes_zero=not numbered, by_content=by_content)
        self._numbered = numbered
        self._by_content = by_content
        self._transaction = 0
        self._device = 0

    def frame(self, device: int, pdu: bytes) -> bytes:
        """Return the frame of a request."""
        if not self._numbered or self._by_content:
            self._guard.clear()
        self._transaction = self._transaction % _TRANSACTIONS + 1
        self._device = device
        return tcp_frame(device, self._transaction, pdu)

    def feed(self, data: bytes, device: int, pdu: bytes) -> bytes | None:
        """Return the PDU of the reply to that request, or None until it is whole; raise ProtocolError."""
        frames = self._guard.feed(data, self._transaction, device, pdu)
        if self._numbered or not frames:
            return frames[0][HEADER.size :] if frames else None
        if len(frames) > 1 or self._guard.holds:
            raise ProtocolError("more than one reply to one request: none of them is used")
        reply = frames[0][HEADER.size :]
        if not answers(reply, pdu):
            raise ProtocolError("a reply to another request")
        return reply

    @property
    def unused(self) -> str | None:
        """Sentence about bytes that came and were no answer to the request; None where none came."""
        guard = self._guard
        begun = guard.unfinished(self._transaction, self._device)
        if begun is not None or guard.others is None:
            return begun
        transaction, unit = guard.others
        said = _counted(guard.dropped)
        if guard.zeros:
            return f"{said}; it answers with transaction 0: give transaction = 'zero' where it always does"
        if transaction == self._transaction:
            return f"{said}: unit {unit} answers where device_id {self._device} was asked; correct device_id"
        said = f"{said}: the last has transaction {transaction} where {self._transaction} was asked"
        is_ahead = (self._transaction - transaction) % _TRANSACTIONS > _TRANSACTIONS // 2
        if is_ahead or transaction in self._guard.repeated:
            return f"{said}; it does not repeat the number of the request, which Modbus/TCP asks of a device or gateway"
        return f"{said}; raise timeout_s where the device is slow"


class RtuFrames:
    """RTU frames (Modbus over serial line V1.02, 2.5.1)."""

    def __init__(self) -> None:
        self._guard = RtuGuard()
        self._came = b""

    def frame(self, device: int, pdu: bytes) -> bytes:
        """Return the frame of a request."""
        self._guard.clear()
        self._came = b""
        return rtu_frame(device, pdu)

    def feed(self, data: bytes, device: int, pdu: bytes) -> bytes | None:
        """Return the PDU of the reply to that request, or None until it is whole; raise ProtocolError."""
        self._came += data
        try:
            passed = self._guard.feed(data, device, pdu)
        except ProtocolError:
            said = _not_rtu(self._came)
            if said is None:
                raise
            raise ProtocolError(said) from None
        return passed[0] if passed else None

    @property
    def unused(self) -> str | None:
        """Sentence about bytes that came and were no answer to the request; None where none came."""
        if self._guard.others is not None:
            return f"{_counted(self._guard.dropped)}: {self._guard.others}"
        said = _not_rtu(self._came)
        if said is not None or not self._came:
            return said
        return f"only {len(self._came)} bytes of a reply came ({self._came[:8].hex(' ')})"


def _not_rtu(data: bytes) -> str | None:
    """Return a sentence about bytes on an RTU line that have another framing, or None."""
    if is_tcp_frame(data):
        return "the reply is in Modbus/TCP framing; use transport = 'modbus_tcp'"
    return service_of(data)


def _counted(dropped: int) -> str:
    """Return the beginning of a sentence about replies to another request or of another unit."""
    return "a reply was not used" if dropped == 1 else f"{dropped} replies were not used"


def frames_of(config: ModbusBusSection) -> TcpFrames | RtuFrames:
    """Return the frames of a bus, at the beginning of a connection."""
    if is_rtu(config):
        return RtuFrames()
    by_content = isinstance(config, ModbusTcpBus) and config.frame_length == "ignored"
    return TcpFrames(numbered=is_numbered(config), by_content=by_content)
