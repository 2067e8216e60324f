"""Modbus/TCP server: request bytes in, response bytes out, any number pipelined, answered in order.

It is own code because pymodbus's server answers only the first of several pipelined requests and takes most of the
time of an accelerated replay.
"""

import asyncio
import struct
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Protocol

DEVICE_ID = 1
"""Device number of the virtual rig's PLC."""
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, NO_SUCH_DEVICE = 1, 2, 3, 0x0B

_HEAD = struct.Struct(">HHHBB")
_TWO = struct.Struct(">HH")
_PDU_LIMIT = 253
_FUNCTIONS = (1, 2, 3, 4, 5, 6, 15, 16, 22, 23)

BitTable = Literal["coil", "discrete"]
RegisterTable = Literal["holding", "input"]


class RefusedRequest(Exception):
    """Error of a request that gets an exception response."""

    def __init__(self, code: int) -> None:
        self.code = code


class Memory(Protocol):
    """Registers and bits of a device. Each method raises RefusedRequest for addresses or values that it has not."""

    def read_registers(self, table: RegisterTable, first: int, count: int) -> bytes:
        """Return `count` registers, big-endian."""

    def read_bits(self, table: BitTable, first: int, count: int) -> int:
        """Return `count` bits, the first one as bit 0."""

    def write_registers(self, first: int, values: Sequence[int]) -> None:
        """Write holding registers, all or none."""

    def write_bits(self, first: int, values: Sequence[int]) -> None:
        """Write coils, all or none."""


Devices = Mapping[int, Memory]
"""Memories by device number."""


def answer(memory: Memory, pdu: bytes) -> bytes:
    """Return the response PDU to a request PDU."""
    function = pdu[0]
    try:
        return _serve(memory, function, pdu)
    except RefusedRequest as refused:
        return bytes((function | 0x80, refused.code))


def _serve(memory: Memory, function: int, pdu: bytes) -> bytes:
    if function not in _FUNCTIONS:
        raise RefusedRequest(ILLEGAL_FUNCTION)
    if len(pdu) < 5:
        raise RefusedRequest(ILLEGAL_VALUE)
    first, count = _TWO.unpack_from(pdu, 1)
    if function in (3, 4):
        _fixed(pdu, 5)
        _check(count, 125)
        return bytes((function, 2 * count)) + memory.read_registers(
            "input" if function == 4 else "holding", first, count
        )
    if function == 16:
        return _write_many(memory, pdu, first, count)
    if function == 6:
        _fixed(pdu, 5)
        memory.write_registers(first, (count,))
        return pdu
    if function in (1, 2):
        _fixed(pdu, 5)
        _check(count, 2000)
        size = (count + 7) // 8
        bits = memory.read_bits("coil" if function == 1 else "discrete", first, count)
        return bytes((function, size)) + bits.to_bytes(size, "little")
    if function == 5:
        _fixed(pdu, 5)
        if count not in (0x0000, 0xFF00):
            raise RefusedRequest(ILLEGAL_VALUE)
        memory.write_bits(first, (1 if count else 0,))
        return pdu
    if function == 15:
        if len(pdu) < 6 or pdu[5] != (count + 7) // 8 or len(pdu) != 6 + pdu[5]:
            raise RefusedRequest(ILLEGAL_VALUE)
        _check(count, 1968)
        bits = int.from_bytes(pdu[6:], "little")
        memory.write_bits(first, [bits >> at & 1 for at in range(count)])
        return pdu[:5]
    if function == 22:
        _fixed(pdu, 7)
        keep, put = _TWO.unpack_from(pdu, 3)
        (held,) = struct.unpack(">H", memory.read_registers("holding", first, 1))
        memory.write_registers(first, ((held & keep) | (put & ~keep & 0xFFFF),))
        return pdu
    return _read_write_many(memory, pdu, first, count)


def _write_many(memory: Memory, pdu: bytes, first: int, count: int) -> bytes:
    if len(pdu) < 6 or pdu[5] != 2 * count or len(pdu) != 6 + 2 * count:
        raise RefusedRequest(ILLEGAL_VALUE)
    _check(count, 123)
    memory.write_registers(first, struct.unpack_from(f">{count}H", pdu, 6))
    return pdu[:5]


def _read_write_many(memory: Memory, pdu: bytes, first: int, count: int) -> bytes:
    if len(pdu) < 10:
        raise RefusedRequest(ILLEGAL_VALUE)
    to, number = _TWO.unpack_from(pdu, 5)
    if pdu[9] != 2 * number or len(pdu) != 10 + 2 * number:
        raise RefusedRequest(ILLEGAL_VALUE)
    _check(count, 125)
    _check(number, 121)
    memory.read_registers("holding", first, count)  # refuses what cannot be read before anything is written
    memory.write_registers(to, struct.unpack_from(f">{number}H", pdu, 10))
    return bytes((23, 2 * count)) + memory.read_registers("holding", first, count)


def _fixed(pdu: bytes, length: int) -> None:
    if len(pdu) != length:
        raise RefusedRequest(ILLEGAL_VALUE)


def _check(count: int, limit: int) -> None:
    """Refuse a wrong quantity; a wrong address comes after it, as in the specification's state diagrams."""
    if not 1 <= count <= limit:
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
    """Connection of one client of Modbus/TCP to the devices behind one port."""

    def __init__(self, devices: Devices, connections: "set[ModbusConnection]") -> None:
        super().__init__(connections)
        self._devices = devices
        self._rest = b""

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
            memory = self._devices.get(device)
            absent = bytes((function | 0x80, NO_SUCH_DEVICE))
            pdu = absent if memory is None else answer(memory, data[at + 7 : stop])
            answers.append(_HEAD.pack(transaction, 0, len(pdu) + 1, device, pdu[0]) + pdu[1:])
            at = stop
        self._rest = data[at:]
        if answers:
            self._transport.write(answers[0] if len(answers) == 1 else b"".join(answers))
