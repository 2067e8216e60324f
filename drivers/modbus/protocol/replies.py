"""Guard of Modbus/TCP frames: bytes of a connection matched to the request that waits. Pure, no I/O.

pymodbus takes a reply of transaction 0 for any request, ignores bytes behind a reply's data and waits for ever on a
header of another protocol. Here a frame is passed on only when it is whole, of the request's transaction and unit, and
as long as it says (Modbus messaging on TCP/IP implementation guide V1.0b, 3.1.3; application protocol V1.1b3, 6 and 7).

An exception reply is passed on whatever its length field says: it holds no value, and its two bytes say all. One item
that a device refuses so must not take the connection, and with it all others.
"""

from __future__ import annotations

import struct

from drivers.modbus.protocol.reply_defects import (
    HEADER,
    IGNORED,
    LONGEST,
    READS,
    SHORTEST,
    content_size,
    defect_of,
    foreign_frame,
    is_exception_to,
    unfinished,
    wrong_length,
)
from drivers.signals import ProtocolError

_EXCEPTION = HEADER.size + 2


class FrameGuard:
    """Splitter of a connection's bytes into frames. `dropped` counts whole frames that answer no request of ours.

    `zeros` are those of them with transaction 0 and the unit that was asked. With `takes_zero` they are replies. With
    `by_content` a reply is as long as its function and byte count say, whatever its header announces.
    """

    def __init__(self, *, takes_zero: bool = False, by_content: bool = False) -> None:
        self.dropped = 0
        self.zeros = 0
        self.others: tuple[int, int] | None = None
        """Transaction and unit of the last frame that was dropped."""
        self.repeated: set[int] = set()
        """Transactions of two dropped frames that came one after the other: a late reply comes once."""
        self._takes_zero = takes_zero
        self._by_content = by_content
        self._buffer = b""
        self._owed = 0
        self._behind = 0

    @property
    def holds(self) -> bool:
        """True while a frame has begun and is not whole."""
        return bool(self._buffer)

    def clear(self) -> None:
        """Forget what has arrived."""
        self._buffer, self._owed, self._behind = b"", 0, 0

    def unfinished(self, transaction: int, unit: int) -> str | None:
        """Return a sentence about the bytes that are no whole frame, or None where there are none."""
        return unfinished(self._buffer, transaction, unit)

    def feed(self, data: bytes, transaction: int, unit: int, request: bytes = b"") -> list[bytes]:
        """Return frames that answer `request` of this transaction and unit; raise ProtocolError.

        After an error nothing more can be read from this connection: the beginning of the next frame is not known.
        """
        self._buffer = self._buffer + data if self._buffer else data
        passed: list[bytes] = []
        if self._owed or self._by_content:
            self._skip(transaction)
        while len(self._buffer) >= HEADER.size:
            tid, protocol, length, sender = HEADER.unpack_from(self._buffer)
            if protocol != 0:
                behind = f"{self._behind} bytes came behind a reply, more than its header announces; {IGNORED}"
                raise ProtocolError(behind if self._behind else foreign_frame(self._buffer))
            is_ours = (tid == transaction or (self._takes_zero and tid == 0)) and sender == unit
            size = self._size(length, is_ours, request)
            if size is None:
                break
            frame = self._buffer[:size]
            if is_ours and is_exception_to(frame[HEADER.size :], request):
                self._owed = max(HEADER.size - 1 + length - len(self._buffer), 0)
                frame = frame[:_EXCEPTION]
            elif is_ours and not self._by_content:
                _check_length(length, frame[HEADER.size :], self._buffer[HEADER.size :], request)
            self._buffer = self._buffer[size:]
            if is_ours:
                passed.append(frame)
                self._behind = len(self._buffer)
                continue
            self.dropped += 1
            self.zeros += tid == 0 and sender == unit
            if self.others is not None and self.others[0] == tid:
                self.repeated.add(tid)
            self.others = tid, sender
        return passed

    def _skip(self, transaction: int) -> None:
        """Drop bytes that an exception reply announced and that came late, unless the next reply begins here."""
        begins = struct.pack(">HH", transaction, 0)
        if self._by_content and not self._takes_zero:
            at = self._buffer.find(begins)
            self._buffer = self._buffer[max(at, 0) :]
        elif self._owed and self._buffer and not begins.startswith(self._buffer[: len(begins)]):
            owed = min(self._owed, len(self._buffer))
            self._buffer, self._owed = self._buffer[owed:], self._owed - owed
        else:
            self._owed = 0

    def _size(self, length: int, is_ours: bool, request: bytes) -> int | None:
        """Return the number of bytes of the buffer's first frame; None while they are not all there."""
        announced = HEADER.size - 1 + length
        here = len(self._buffer)
        pdu = self._buffer[HEADER.size :]
        if is_ours and is_exception_to(pdu, request):
            return min(max(announced, _EXCEPTION), here) if SHORTEST <= length <= LONGEST else _EXCEPTION
        if self._by_content:
            due = content_size(pdu)
            if due is None and len(pdu) > 1:
                raise ProtocolError(wrong_length(length, pdu))
            return None if due is None or len(pdu) < due else HEADER.size + due
        if not SHORTEST <= length <= LONGEST:
            if is_ours and here < _EXCEPTION:
                return None  # an exception reply with a wrong length may still come
            raise ProtocolError(wrong_length(length, pdu) if is_ours and pdu else foreign_frame(self._buffer))
        return None if here < announced else announced


def answers(reply: bytes, request: bytes) -> bool:
    """Return True where a reply has the function and the length, or the echo, that a request asks for."""
    code, count = request[0], int.from_bytes(request[3:5], "big")
    if reply[0] == code | 0x80:
        return True
    if reply[0] != code:
        return False
    if code in READS:
        return reply[1] == (-(-count // 8) if code in (1, 2) else 2 * count)
    return reply == request[:5]


def _check_length(length: int, pdu: bytes, arrived: bytes, request: bytes) -> None:
    """Raise ProtocolError where a reply is not as long as its function and byte count say.

    `arrived` are all its bytes, which may be more than its header announces.
    """
    if (defect := defect_of(pdu, request)) is not None:
        raise ProtocolError(defect)
    code, due = pdu[0], content_size(pdu)
    if due is None:
        raise ProtocolError(f"a reply of function {code}, which was not asked for")
    if len(pdu) != due:
        said = f"a reply of function {code} announces {length} bytes and its content has {1 + due}"
        raise ProtocolError(f"{said}; {IGNORED}" if len(arrived) >= due else said)
