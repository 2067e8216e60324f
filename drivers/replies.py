"""Which bytes of a Modbus/TCP connection may be the reply to the request that waits: pure, no I/O.

pymodbus takes a reply of transaction 0 for any request, ignores bytes behind a reply's data and waits for ever on a
header of another protocol. Here a frame is passed on only when it is whole, of the request's transaction and unit, and
as long as it says (Modbus messaging on TCP/IP implementation guide V1.0b, 3.1.3; application protocol V1.1b3, 6 and 7).
"""

from __future__ import annotations

import struct

from drivers.points import ProtocolError

_HEADER = struct.Struct(">HHHB")
_SHORTEST, _LONGEST = 3, 254  # unit, function and one byte; unit and a PDU of 253 bytes
READS = (1, 2, 3, 4, 23)
ECHOES = (5, 6, 15, 16)


class FrameGuard:
    """Cuts what arrives into frames. `dropped` counts whole frames that belong to no request of ours.

    `zeros` are those of them that had transaction 0, and else what was asked. With `takes_zero` they are replies.
    """

    def __init__(self, *, takes_zero: bool = False) -> None:
        self.dropped = 0
        self.zeros = 0
        self._takes_zero = takes_zero
        self._buffer = b""

    @property
    def holds(self) -> bool:
        """Whether a frame has begun."""
        return bool(self._buffer)

    def clear(self) -> None:
        """Forget what has arrived."""
        self._buffer = b""

    def feed(self, data: bytes, transaction: int, unit: int) -> list[bytes]:
        """Frames that answer the request of this transaction and unit; ProtocolError where the stream makes no sense.

        After an error nothing more can be read from this connection: where the next frame begins is not known.
        """
        self._buffer = self._buffer + data if self._buffer else data
        passed: list[bytes] = []
        while len(self._buffer) >= _HEADER.size:
            tid, protocol, length, sender = _HEADER.unpack_from(self._buffer)
            if protocol != 0 or not _SHORTEST <= length <= _LONGEST:
                raise ProtocolError(f"a frame of protocol {protocol} and length {length}, which is none of Modbus")
            size = _HEADER.size - 1 + length
            if len(self._buffer) < size:
                break
            frame, self._buffer = self._buffer[:size], self._buffer[size:]
            is_ours = tid == transaction or (self._takes_zero and tid == 0)
            if not is_ours or sender != unit:
                self.dropped += 1
                self.zeros += tid == 0 and sender == unit
                continue
            _check_length(frame[_HEADER.size :])
            passed.append(frame)
        return passed


def answers(reply: bytes, request: bytes) -> bool:
    """Whether a reply has the function and the length, or the echo, that a request asks for."""
    code, count = request[0], int.from_bytes(request[3:5], "big")
    if reply[0] == code | 0x80:
        return True
    if reply[0] != code:
        return False
    if code in READS:
        return reply[1] == (-(-count // 8) if code in (1, 2) else 2 * count)
    return reply == request[:5]


def _check_length(pdu: bytes) -> None:
    """Raise ProtocolError where a reply is not as long as its function and byte count say."""
    code = pdu[0]
    if code > 0x80:
        due = 2
    elif code in READS:
        due = 2 + pdu[1]
    elif code in ECHOES:
        due = 5
    else:
        raise ProtocolError(f"a reply of function {code}, which was not asked for")
    if len(pdu) != due:
        raise ProtocolError(f"a reply of function {code} with {len(pdu)} bytes where it says {due}")
