"""Requests of blocks, and the checks of their replies, without framing: pure (Modbus application protocol V1.1b3).

pymodbus encodes and decodes; here a reply is checked against what was asked before its values are taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NoReturn

from drivers.modbus.protocol import pymodbus_codec as codec
from drivers.modbus.read_plan import BIT_TABLES, Block
from drivers.signals import DeviceExceptionError, ProtocolError

NO_SUCH_FUNCTION = 1
NO_SUCH_ADDRESS = 2
BUSY = 6
_VALUE = 3
OF_CONTENT = frozenset({2, 3, 4, 8})
"""Exceptions that one address of a request, or their number, may cause: a smaller request may be answered."""
_WRITE_CODES = frozenset({5, 6, 15, 16, 23})
_SISTERS = {1: "discrete", 2: "coil", 3: "input", 4: "holding"}
"""Table that a device without a function to read may mean, by that function."""
_SINGLE = {5: 15, 6: 16}
"""Functions that write a single value, and those that write several."""
GATEWAY_SILENCE = 11
EXCEPTIONS = {
    1: "function not supported",
    2: "address does not exist (is the address zero-based?)",
    3: "value not accepted",
    4: "device failure",
    5: "still working on it",
    6: "device busy",
    7: "refused without a reason",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target does not answer (is device_id right?)",
}

NO_VALUES = "the device has no values there: correct address and table, or take the points out"
"""Remedy for a reply without values."""


class ReadBack:
    """Request that writes a block of holding registers and then reads one (6.17), and the check of its reply."""

    code = 23

    def __init__(self, written: Block, raw: Sequence[int], read: Block) -> None:
        self.read = read
        self.request = codec.read_back_request((read.address, read.count), written.address, raw)
        self._written = written

    def raw_of(self, reply: bytes, where: str) -> Sequence[int]:
        """Return the registers of the block that is read; raise ProtocolError, or DeviceExceptionError of a refusal."""
        _check_function(self.code, self._written, reply, where)
        count = self.read.count
        if reply[1] != 2 * count or len(reply) < 2 + 2 * count:
            raise ProtocolError(_other_size(where, reply[1], 2 * count, self.read))
        return codec.values_of(reply, count)


class Read:
    """Request that reads a block (6.1 to 6.4), and the check of its reply."""

    def __init__(self, block: Block) -> None:
        self.block = block
        self.request = codec.read_request(block.read_code, block.address, block.count)
        self._is_bits = block.table in BIT_TABLES
        size = -(-block.count // 8) if self._is_bits else 2 * block.count
        self._head = bytes((block.read_code, size))
        self._size = 2 + size

    def raw_of(self, reply: bytes, where: str) -> Sequence[int]:
        """Return the block's registers, or bits as 0 and 1; raise ProtocolError where the reply is not the block's."""
        if reply[:2] != self._head or len(reply) < self._size:
            self._refuse(reply, where)
        return codec.values_of(reply, self.block.count)

    def _refuse(self, reply: bytes, where: str) -> NoReturn:
        block = self.block
        _check_function(block.read_code, block, reply, where)
        raise ProtocolError(_other_size(where, reply[1], self._size - 2, block))


def _other_size(where: str, got: int, asked: int, block: Block) -> str:
    """Return a sentence about a reply with another number of bytes than was asked for."""
    is_bits = block.table in BIT_TABLES
    whole = (lambda size: f"{8 * size} bits") if is_bits else lambda size: f"{size // 2} registers"
    if got == 0:
        said, remedy = f"no value (byte count 0) for {block}", NO_VALUES
    elif got % 2 and not is_bits:
        size = "1 byte" if got == 1 else f"{got} bytes"
        said, remedy = f"{size} for {block}, where a register has two", "the device or its gateway is faulty"
    else:
        said = f"{whole(got)} where {block.count if is_bits else asked // 2} were asked ({block})"
        key = f"max_read_bits = {8 * got}" if is_bits else f"max_read = {got // 2}"
        remedy = f"give the bus {key} where it reads no more at once"
        if got > asked:
            remedy = "look for another client of the device, whose replies its gateway mixes with these"
    return f"{where} answered {said}; the reply is not used: {remedy}"


def write_request(block: Block, raw: Sequence[int]) -> bytes:
    """Return the request that writes a block of registers, or of bits as 0 and 1 (6.5, 6.6, 6.11 and 6.12)."""
    return codec.write_request(block.write_code, block.address, raw)


def check_written(block: Block, raw: Sequence[int], request: bytes, reply: bytes, where: str) -> None:
    """Check that a device confirms the write that was sent.

    Parameters
    ----------
    block, raw
        Registers or bits that were written, and their values.
    request, reply
        PDUs that were sent and received.
    where
        Device and point, for the message.

    Raises
    ------
    ProtocolError
        The device confirms another write.
    """
    code = block.write_code
    _check_function(code, block, reply, where)
    address, said = codec.confirmation_of(reply)
    if code in (15, 16):
        if (address, said) != (block.address, block.count):
            what = "coils" if code == 15 else "registers"
            raise ProtocolError(
                f"{where} confirmed {said} {what} at {address}, asked were {block.count} at {block.address}"
            )
    elif reply[:5] != request:
        raise ProtocolError(f"{where} echoed [{said}] at {address} to a write of {list(raw)} at {block.address}")


def _remedy_of(code: int, block: Block) -> str:
    """Return the remedy for a device that lacks the function which writes `block`, or ""."""
    if code in _SINGLE:
        return f" (give the bus write_multiple = true where the device writes with function {_SINGLE[code]} alone)"
    if code not in _SINGLE.values():
        return ""
    if block.multiple and block.count == 1:
        return " (take write_multiple out of the bus)"
    if any(point.width > 1 for point in block.points):
        return " (its value of several registers goes in one request; write it to a device that has function 16)"
    key = "max_write_bits" if block.table in BIT_TABLES else "max_write"
    return f" (give the bus {key} = 1 where the device writes single values alone)"


def _check_function(code: int, block: Block, reply: bytes, where: str) -> None:
    if len(reply) < 2:
        raise ProtocolError(f"{where} answered nothing that is a reply")
    if reply[0] == code | 0x80:
        exception = codec.exception_of(reply)
        what = EXCEPTIONS.get(exception, "which the protocol does not know; see the manual of the device")
        asked = str(block)
        if exception == _VALUE and code not in _WRITE_CODES:
            what = "it does not read so many at once (give the bus max_read or max_read_bits)"
        elif exception == NO_SUCH_FUNCTION and code in _SISTERS:
            what += f" (are these points in table '{_SISTERS[code]}'?)"
        elif code in _WRITE_CODES:
            if exception == NO_SUCH_FUNCTION:
                what += _remedy_of(code, block)
            asked = f"to write {block} with function {code}"
        raise DeviceExceptionError(f"{where} refused {asked}: exception {exception}, {what}", exception)
    if reply[0] != code:
        raise ProtocolError(
            f"{where} answered function {reply[0] & 0x7F} to function {code}; the reply is not used: look for another "
            "client of the device, whose replies its gateway mixes with these"
        )
