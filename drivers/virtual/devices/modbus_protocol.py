"""Modbus/TCP server: request bytes in, response bytes out, any number pipelined, answered in order.

It is own code because pymodbus's server answers only the first of several pipelined requests and takes most of the
time of an accelerated replay.
"""

import asyncio
import struct
from typing import Any

from drivers.virtual.devices.registers import ARM, ARMED, HOLDING_COUNT, INPUT_COUNT, STATUS_BITS, Registers

DEVICE_ID = 1
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, NO_SUCH_DEVICE = 1, 2, 3, 0x0B
COIL_COUNT = 1

_HEAD = struct.Struct(">HHHBB")
_TWO = struct.Struct(">HH")
_PDU_LIMIT = 253
_FUNCTIONS = (1, 2, 3, 4, 5, 6, 15, 16, 22, 23)


class RefusedRequest(Exception):
    """Error of a request that gets an exception response."""

    def __init__(self, code: int) -> None:
        self.code = code


def answer(registers: Registers, pdu: bytes) -> bytes:
    """Return the response PDU to a request PDU."""
    function = pdu[0]
    try:
        return _serve(registers, function, pdu)
    except RefusedRequest as refused:
        return bytes((function | 0x80, refused.code))


def _serve(registers: Registers, function: int, pdu: bytes) -> bytes:
    if function not in _FUNCTIONS:
        raise RefusedRequest(ILLEGAL_FUNCTION)
    if len(pdu) < 5:
        raise RefusedRequest(ILLEGAL_VALUE)
    first, count = _TWO.unpack_from(pdu, 1)
    if function == 4:
        _fixed(pdu, 5)
        _check(first, count, 125, INPUT_COUNT)
        return bytes((4, 2 * count)) + registers.inputs[2 * first : 2 * (first + count)]
    if function == 3:
        _fixed(pdu, 5)
        values = _read_holding(registers, first, count)
        return bytes((3, 2 * count)) + values
    if function == 16:
        return _write_many(registers, pdu, first, count)
    if function == 6:
        _fixed(pdu, 5)
        _check(first, 1, 1, HOLDING_COUNT)
        _write(registers, first, (count,))
        return pdu
    if function in (1, 2):
        _fixed(pdu, 5)
        _check(first, count, 2000, COIL_COUNT if function == 1 else STATUS_BITS)
        bits = (registers.status & ARMED) if function == 1 else registers.status
        return bytes((function, 1, (bits >> first) & ((1 << count) - 1)))
    if function == 5:
        _fixed(pdu, 5)
        if count not in (0x0000, 0xFF00):
            raise RefusedRequest(ILLEGAL_VALUE)
        _check(first, 1, 1, COIL_COUNT)
        _write(registers, ARM, (1 if count else 0,))
        return pdu
    if function == 15:
        if len(pdu) < 6 or pdu[5] != (count + 7) // 8 or len(pdu) != 6 + pdu[5]:
            raise RefusedRequest(ILLEGAL_VALUE)
        _check(first, count, 1968, COIL_COUNT)
        _write(registers, ARM, (pdu[6] & 1,))
        return pdu[:5]
    if function == 22:
        _fixed(pdu, 7)
        _check(first, 1, 1, HOLDING_COUNT)
        keep, put = _TWO.unpack_from(pdu, 3)
        _write(registers, first, ((registers.holding[first] & keep) | (put & ~keep & 0xFFFF),))
        return pdu
    return _read_write_many(registers, pdu, first, count)


def _write_many(registers: Registers, pdu: bytes, first: int, count: int) -> bytes:
    if len(pdu) < 6 or pdu[5] != 2 * count or len(pdu) != 6 + 2 * count:
        raise RefusedRequest(ILLEGAL_VALUE)
    _check(first, count, 123, HOLDING_COUNT)
    _write(registers, first, struct.unpack_from(f">{count}H", pdu, 6))
    return pdu[:5]


def _read_write_many(registers: Registers, pdu: bytes, first: int, count: int) -> bytes:
    if len(pdu) < 10:
        raise RefusedRequest(ILLEGAL_VALUE)
    to, number = _TWO.unpack_from(pdu, 5)
    if pdu[9] != 2 * number or len(pdu) != 10 + 2 * number:
        raise RefusedRequest(ILLEGAL_VALUE)
    _check(first, count, 125, HOLDING_COUNT)
    _check(to, number, 121, HOLDING_COUNT)
    _write(registers, to, struct.unpack_from(f">{number}H", pdu, 10))
    return bytes((23, 2 * count)) + _read_holding(registers, first, count)


def _read_holding(registers: Registers, first: int, count: int) -> bytes:
    _check(first, count, 125, HOLDING_COUNT)
    return struct.pack(f">{count}H", *registers.holding[first : first + count])


def _fixed(pdu: bytes, length: int) -> None:
    if len(pdu) != length:
        raise RefusedRequest(ILLEGAL_VALUE)


def _check(first: int, count: int, limit: int, size: int) -> None:
    """Refuse a wrong quantity, then a wrong address: the order of the specification's state diagrams."""
    if not 1 <= count <= limit:
        raise RefusedRequest(ILLEGAL_VALUE)
    if first + count > size:
        raise RefusedRequest(ILLEGAL_ADDRESS)


def _write(registers: Registers, first: int, values: tuple[int, ...]) -> None:
    if not registers.write(first, values):
        raise RefusedRequest(ILLEGAL_VALUE)


class Connection(asyncio.Protocol):
    """Connection of one client. A client that does not read its answers is not read either."""

    def __init__(self, connections: set[Any]) -> None:
        self._connections = connections
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Register with the server."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._connections.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the client."""
        self._connections.discard(self)

    def close(self) -> None:
        """Drop the client."""
        self._transport.abort()

    def pause_writing(self) -> None:
        """Stop reading requests: answers pile up."""
        self._transport.pause_reading()

    def resume_writing(self) -> None:
        """Read requests again: the answers went out."""
        self._transport.resume_reading()


class ModbusConnection(Connection):
    """Connection of one client of Modbus/TCP."""

    def __init__(self, registers: Registers, connections: "set[ModbusConnection]") -> None:
        super().__init__(connections)
        self._registers = registers
        self._rest = b""

    def reply(self, pdu: bytes) -> bytes:
        """Return the response PDU to a request PDU; a device of another register map answers in its own way."""
        return answer(self._registers, pdu)

    def data_received(self, data: bytes) -> None:
        """Answer every whole frame in the buffer with one write; keep a partial one."""
        if self._rest:
            data = self._rest + data
        end, at = len(data), 0
        answers: list[bytes] = []
        while end - at >= 8:
            transaction, protocol, length, device, function = _HEAD.unpack_from(data, at)
            if not 2 <= length <= _PDU_LIMIT + 1 or protocol != 0:
                # The stream has lost its framing and cannot be trusted again.
                self._transport.write(b"".join(answers))
                self._transport.close()
                return
            stop = at + 6 + length
            if stop > end:
                break
            absent = bytes((function | 0x80, NO_SUCH_DEVICE))
            pdu = self.reply(data[at + 7 : stop]) if device == DEVICE_ID else absent
            answers.append(_HEAD.pack(transaction, 0, len(pdu) + 1, device, pdu[0]) + pdu[1:])
            at = stop
        self._rest = data[at:]
        if answers:
            self._transport.write(answers[0] if len(answers) == 1 else b"".join(answers))
