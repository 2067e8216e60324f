"""PDUs and frames of Modbus by pymodbus. No other module of the client imports it.

pymodbus encodes requests, decodes replies and builds frames. The matching of replies to requests, the deadlines and the
checks are this project's (`replies`, `rtu`): pymodbus's client takes a late reply of a serial line for that to the next
request, and accepts a reply with transaction 0 for any.
"""

from __future__ import annotations

from collections.abc import Sequence

from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu import bit_message as bits
from pymodbus.pdu import register_message as registers

_READS: dict[int, type[ModbusPDU]] = {
    1: bits.ReadCoilsRequest,
    2: bits.ReadDiscreteInputsRequest,
    3: registers.ReadHoldingRegistersRequest,
    4: registers.ReadInputRegistersRequest,
}
_WRITES: dict[int, type[ModbusPDU]] = {
    5: bits.WriteSingleCoilRequest,
    6: registers.WriteSingleRegisterRequest,
    15: bits.WriteMultipleCoilsRequest,
    16: registers.WriteMultipleRegistersRequest,
}
_BIT_CODES = frozenset({1, 2, 5, 15})
_REPLIES: dict[int, type[ModbusPDU]] = {
    1: bits.ReadCoilsResponse,
    2: bits.ReadDiscreteInputsResponse,
    3: registers.ReadHoldingRegistersResponse,
    4: registers.ReadInputRegistersResponse,
    5: bits.WriteSingleCoilResponse,
    6: registers.WriteSingleRegisterResponse,
    15: bits.WriteMultipleCoilsResponse,
    16: registers.WriteMultipleRegistersResponse,
    23: registers.ReadWriteMultipleRegistersResponse,
}
_TCP = FramerSocket(DecodePDU(False))
_RTU = FramerRTU(DecodePDU(False))


def _encoded(pdu: ModbusPDU) -> bytes:
    return bytes((pdu.function_code,)) + pdu.encode()


def read_request(code: int, address: int, count: int) -> bytes:
    """Return the PDU that reads `count` registers or bits from `address` (6.1 to 6.4)."""
    return _encoded(_READS[code](address=address, count=count))


def write_request(code: int, address: int, raw: Sequence[int]) -> bytes:
    """Return the PDU that writes registers, or bits as 0 and 1 (6.5, 6.6, 6.11 and 6.12)."""
    kind = _WRITES[code]
    if code in _BIT_CODES:
        return _encoded(kind(address=address, bits=[bool(bit) for bit in raw]))
    return _encoded(kind(address=address, registers=raw))


def read_back_request(read: tuple[int, int], address: int, raw: Sequence[int]) -> bytes:
    """Return the PDU that writes registers from `address` and then reads `(address, count)` (6.17)."""
    return _encoded(
        registers.ReadWriteMultipleRegistersRequest(
            read_address=read[0], read_count=read[1], write_address=address, write_registers=raw
        )
    )


def values_of(reply: bytes, count: int) -> Sequence[int]:
    """Return the registers, or the first `count` bits as 0 and 1, of a whole reply to a read."""
    pdu = _REPLIES[reply[0]]()
    pdu.decode(reply[1:])
    if reply[0] in _BIT_CODES:
        return [int(bit) for bit in pdu.bits[:count]]
    return pdu.registers


def confirmation_of(reply: bytes) -> tuple[int, int]:
    """Return address and count of a reply to 6.11 or 6.12; address and value as sent of one to 6.5 or 6.6."""
    pdu = _REPLIES[reply[0]]()
    pdu.decode(reply[1:])
    if reply[0] in (15, 16):
        return pdu.address, pdu.count
    return pdu.address, int.from_bytes(reply[3:5], "big")


def exception_of(reply: bytes) -> int:
    """Return the code of an exception reply (7)."""
    pdu = ExceptionResponse(reply[0])
    pdu.decode(reply[1:])
    return pdu.exception_code


def tcp_frame(device: int, transaction: int, pdu: bytes) -> bytes:
    """Return the MBAP frame of a PDU (Modbus messaging on TCP/IP implementation guide V1.0b, 3.1.3)."""
    return _TCP.encode(pdu, device, transaction)


def rtu_frame(device: int, pdu: bytes) -> bytes:
    """Return address, PDU and CRC (Modbus over serial line V1.02, 2.5.1)."""
    return _RTU.encode(pdu, device, 0)


def has_right_crc(frame: bytes) -> bool:
    """Return True where the last two bytes of an RTU frame are the CRC of the others."""
    return FramerRTU.check_CRC(frame[:-2], int.from_bytes(frame[-2:], "big"))


def rtu_size(start: bytes) -> int | None:
    """Return the length of the RTU reply that begins with `start`, at least two bytes; None where it takes more bytes.

    Raises
    ------
    KeyError
        No reply has this function.
    """
    kind = ExceptionResponse if start[1] & 0x80 else _REPLIES[start[1]]
    return kind.calculateRtuFrameSize(start) or None
