"""Defects of Modbus replies as sentences, each with the key of the rig file that helps: pure.

A device that answers wrongly is on, and its cable is right. The sentence names the byte that breaks the protocol, or
the other service that listens on the port.
"""

from __future__ import annotations

import struct

from drivers.modbus.protocol.pdu import EXCEPTIONS

HEADER = struct.Struct(">HHHB")
"""MBAP header: transaction, protocol (0), length of what follows it with the unit, unit."""
SHORTEST, LONGEST = 3, 254
"""Bounds of the header's `length`: unit, function and one byte; unit and a PDU of 253 bytes."""
READS = (1, 2, 3, 4, 23)
ECHOES = (5, 6, 15, 16)
ECHO = (
    "the reply is the request itself, an echo; switch the echo of the adapter or converter off, or correct host and "
    "port where the other side is no Modbus device"
)
IGNORED = "give frame_length = 'ignored' where the device always does so"
_GREETINGS = (
    (b"HTTP/", "a web server (HTTP)"),
    (b"<!DOCTYPE", "a web server (HTTP)"),
    (b"<html", "a web server (HTTP)"),
    (b"SSH-", "an SSH server"),
    (b"< hi >", "a socketcand daemon, which is a CAN bus"),
    (b"RFB ", "a VNC server"),
    (b"220", "a mail or FTP server"),
    (b"\xff\xfb", "a Telnet server"),
    (b"\xff\xfd", "a Telnet server"),
)
_SHOWN = 24
"""Bytes of a text that a sentence quotes."""


def service_of(data: bytes) -> str | None:
    """Return a sentence about the other service whose greeting `data` is; None where it is not known."""
    if not data:
        return None
    for start, name in _GREETINGS:
        if data[: len(start)].lower() == start.lower():
            return f"{name} answers there; correct host and port"
    if data[0] in (0x15, 0x16) and data[1:2] == b"\x03":  # TLS record: alert or handshake, version 3.x (RFC 8446, 5.1)
        return "the port speaks TLS; use transport = 'modbus_tls', or the port without TLS"
    if data[:1] == b":" and all(byte in b":0123456789ABCDEFabcdef\r\n" for byte in data):
        return "the reply is in Modbus ASCII, which is not supported; set the device to RTU or TCP"
    if len(data) >= 4 and all(32 <= byte < 127 or byte in b"\r\n\t" for byte in data[:_SHOWN]):
        return (
            f"a service that answers in text ({data[:_SHOWN].decode('ascii')!r}) listens there; correct host and port"
        )
    return None


def is_rtu_frame(data: bytes) -> bool:
    """Return True where `data` begins with a whole RTU reply: function, size and CRC agree."""
    if len(data) < 5:
        return False
    code = data[1]
    size = 5 if code & 0x80 else 8 if code in ECHOES else 5 + data[2] if code in READS else 0
    if not 5 <= size <= len(data):
        return False
    return _crc(data[: size - 2]) == int.from_bytes(data[size - 2 : size], "little")


def _crc(data: bytes) -> int:
    """Return the CRC-16 of an RTU frame (Modbus over serial line V1.02, 6.2.2); `pymodbus_codec` has the fast one."""
    register = 0xFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xA001 if register & 1 else 0)
    return register


def is_tcp_frame(data: bytes) -> bool:
    """Return True where `data` is one whole Modbus/TCP frame: protocol 0, and as long as its header announces."""
    if len(data) < HEADER.size + 2:
        return False
    _, protocol, length, _ = HEADER.unpack_from(data)
    return protocol == 0 and SHORTEST <= length <= LONGEST and len(data) == HEADER.size - 1 + length


def foreign_frame(data: bytes) -> str:
    """Return a sentence about bytes that do not begin with an MBAP header."""
    if is_rtu_frame(data):
        return "the reply is in RTU framing; use transport = 'modbus_rtu_tcp'"
    said = service_of(data)
    if said is not None:
        return said
    _, protocol, length, _ = HEADER.unpack_from(data)
    if protocol != 0:
        return (
            f"a frame of protocol {protocol} where Modbus has 0 (bytes {data[:8].hex(' ')}): it is none of Modbus; "
            "correct host, port and transport"
        )
    return f"a frame of length {length}, which is none of Modbus (it has {SHORTEST} to {LONGEST}); correct port"


def content_size(pdu: bytes) -> int | None:
    """Return the bytes of a reply's PDU by its function and byte count; None where these are not there or unknown."""
    if not pdu:
        return None
    code = pdu[0]
    if code > 0x80:
        return 2
    if code in READS:
        return 2 + pdu[1] if len(pdu) > 1 else None
    return 5 if code in ECHOES else None


def reply_size(request: bytes) -> int | None:
    """Return the bytes of values that a read asks for; None for any other request."""
    if not request or request[0] not in READS or len(request) < 5:
        return None
    count = int.from_bytes(request[3:5], "big")
    return -(-count // 8) if request[0] in (1, 2) else 2 * count


def defect_of(pdu: bytes, request: bytes) -> str | None:
    """Return a sentence about a reply to a read that repeats the request, or whose byte count is wrong; else None."""
    asked = reply_size(request)
    if asked is None or not pdu or pdu[0] != request[0]:
        return None
    if pdu == request:
        return ECHO
    if len(pdu) == 1:
        return f"a reply of function {pdu[0]} without byte count and values; the device or its gateway is faulty"
    count, has = pdu[1], len(pdu) - 2
    if count != asked and has == asked:
        return (
            f"a reply whose byte count is {count} and that has {_bytes(has)} of values; the device or its gateway is "
            "faulty, and its values are not used"
        )
    return None


def _bytes(count: int) -> str:
    return f"{count} byte" if count == 1 else f"{count} bytes"


def is_exception_to(pdu: bytes, request: bytes) -> bool:
    """Return True where `pdu` begins with an exception reply to `request`, of a code that the protocol knows."""
    return len(pdu) >= 2 and bool(request) and pdu[0] == request[0] | 0x80 and pdu[1] in EXCEPTIONS


def wrong_length(length: int, pdu: bytes) -> str:
    """Return a sentence about a reply to our request whose header announces `length` bytes and whose PDU is `pdu`."""
    due = content_size(pdu)
    if due is None and pdu:
        if pdu[0] in READS:
            return f"a reply of function {pdu[0]} without byte count and values; the device or its gateway is faulty"
        return f"a reply of function {pdu[0]}, which was not asked for"
    has = 1 + (len(pdu) if due is None else due)
    why = f"the reply announces {length} bytes and has {has}"
    return f"{why}; {IGNORED}" if due is not None and len(pdu) >= due else why


def unfinished(data: bytes, transaction: int, unit: int) -> str | None:
    """Return a sentence about an unfinished reply at the deadline; None where no bytes came."""
    if not data:
        return None
    if is_rtu_frame(data):
        return "the reply is in RTU framing; use transport = 'modbus_rtu_tcp'"
    said = service_of(data)
    if said is not None:
        return said
    if len(data) < HEADER.size:
        return f"only {len(data)} bytes of a reply came ({data.hex(' ')})"
    tid, _, length, sender = HEADER.unpack_from(data)
    pdu = data[HEADER.size :]
    if tid not in (0, transaction) or sender != unit:
        return f"a reply that announces {length} bytes stopped after {len(pdu) + 1}"
    due = content_size(pdu)
    if due is None and len(pdu) == length - 1 and pdu:
        return wrong_length(length, pdu)
    if due is not None and len(pdu) < due:
        return f"the reply announces {length} bytes and stopped after {len(pdu) + 1}"
    return f"the reply announces {length} bytes and has {len(pdu) + 1}; {IGNORED}"
