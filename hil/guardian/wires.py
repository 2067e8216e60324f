"""Connections of the guardian process: Modbus requests over TCP, TLS or a serial line, one at a time, blocking.

This module imports the standard library only, see the package. Framing: MBAP (Modbus messaging on TCP/IP implementation
guide V1.0b, 3.1.3) and RTU (Modbus over serial line V1.02, 2.5.1).
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import time
from typing import Any

CONNECT_S = 0.5
"""Longest wait for a connection, s: two attempts fit into the second in which the rig has to be safe."""
_QUIET_S = 0.03
"""Silence on a line that ends an exchange, s: the 3.5 characters of RTU (2.5.1.1) take 16 ms at 2400 bit/s."""
_READ = (1, 2, 3, 4)
"""Function codes that read; the request ends in the number of registers or bits."""
_ECHOED = (5, 6, 15, 16)
"""Function codes whose reply repeats the head of the request."""


class WireError(Exception):
    """Request without a valid reply; the message states the reason."""


class ExceptionReply(WireError):
    """Modbus exception as reply: the device is present and refuses the request."""


class BlockingWire:
    """Connection to the devices on one wire of the plan (`hil.guardian.plan.wire_of`); opened by the first request."""

    def __init__(self, plan: dict[str, Any]) -> None:
        self.place: str = plan["place"]
        self._plan = plan
        self._transaction = os.getpid() & 0x7FFF
        self._socket: socket.socket | None = None
        self._line = -1

    def ask(self, device: int, pdu: bytes) -> bytes:
        """Return the PDU of the reply of `device` to `pdu`; raises WireError.

        After a WireError other than ExceptionReply the wire is closed, and the next request opens it anew.
        """
        try:
            self._open()
            return self._ask_rtu(device, pdu) if self._plan["framing"] == "rtu" else self._ask_mbap(device, pdu)
        except ExceptionReply:
            raise
        except (OSError, ValueError, struct.error) as error:
            self.close()
            reason = "no answer in time" if isinstance(error, TimeoutError) else str(error) or type(error).__name__
            raise WireError(f"{self.place}: {reason}") from None
        except WireError:
            self.close()
            raise

    def close(self) -> None:
        """Close the wire; harmless when repeated."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._line >= 0:
            os.close(self._line)
            self._line = -1

    def _open(self) -> None:
        plan = self._plan
        if self._socket is not None or self._line >= 0:
            return
        if plan["kind"] == "serial":
            self._line = _open_line(plan)
            return
        wire = _connected(plan)
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if plan["kind"] == "tls":
            wire = _secured(wire, plan)
        self._socket = wire
        if plan["connect_delay_s"] > 0.0:
            time.sleep(plan["connect_delay_s"])

    def _ask_mbap(self, device: int, pdu: bytes) -> bytes:
        assert self._socket is not None
        end = time.monotonic() + self._plan["timeout_s"]
        self._transaction = self._transaction % 0xFFFF + 1
        self._socket.sendall(struct.pack(">HHHB", self._transaction, 0, len(pdu) + 1, device) + pdu)
        while True:
            transaction, protocol, size, unit = struct.unpack(">HHHB", self._exactly(7, end))
            if protocol != 0 or not 2 <= size <= 254:
                raise WireError(f"{self.place}: the reply is no Modbus/TCP frame")
            reply = self._exactly(size - 1, end) if self._plan["counts"] else self._pdu(end)
            if transaction == self._transaction or (transaction == 0 and self._plan["framing"] == "mbap0"):
                return _checked(reply, pdu, f"{self.place}, device {unit}")

    def _ask_rtu(self, device: int, pdu: bytes) -> bytes:
        end = time.monotonic() + self._plan["timeout_s"]
        self._fall_silent()
        frame = bytes((device,)) + pdu
        self._send(frame + crc16(frame))
        unit = self._exactly(1, end)
        reply = self._pdu(end)
        if crc16(unit + reply) != self._exactly(2, end) or unit[0] != device:
            raise WireError(f"{self.place}: a reply of another device or with a wrong CRC")
        return _checked(reply, pdu, f"{self.place}, device {device}")

    def _pdu(self, end: float) -> bytes:
        """Return the PDU that arrives, with the length that its function code implies."""
        code = self._exactly(1, end)
        if code[0] & 0x80:
            return code + self._exactly(1, end)
        if code[0] in _ECHOED:
            return code + self._exactly(4, end)
        count = self._exactly(1, end)
        return code + count + self._exactly(count[0], end)

    def _fall_silent(self) -> None:
        """Discard the rest of an exchange that the engine began."""
        end = time.monotonic() + 0.3
        while time.monotonic() < end and select.select([self._descriptor()], [], [], _QUIET_S)[0]:
            if not os.read(self._descriptor(), 4096):
                raise WireError(f"{self.place}: the other side has closed the connection")

    def _descriptor(self) -> int:
        return self._line if self._socket is None else self._socket.fileno()

    def _send(self, data: bytes) -> None:
        if self._socket is not None:
            self._socket.sendall(data)
        elif os.write(self._line, data) != len(data):
            raise WireError(f"{self.place}: the line takes nothing")

    def _exactly(self, count: int, end: float) -> bytes:
        found = b""
        while len(found) < count:
            left = end - time.monotonic()
            if left <= 0.0:
                raise WireError(f"{self.place}: no answer within {self._plan['timeout_s']:g} s")
            if self._socket is not None:
                self._socket.settimeout(left)
                data = self._socket.recv(count - len(found))
            else:
                if not select.select([self._line], [], [], left)[0]:
                    continue
                data = os.read(self._line, count - len(found))
            if not data:
                raise WireError(f"{self.place}: the other side has closed the connection")
            found += data
        return found


def _checked(reply: bytes, request: bytes, where: str) -> bytes:
    """Return `reply` where it answers and confirms `request`; raises WireError."""
    if len(reply) >= 2 and reply[0] == request[0] | 0x80:
        raise ExceptionReply(f"{where} refuses function {request[0]}: exception {reply[1]}")
    if not reply or reply[0] != request[0]:
        raise WireError(f"{where} answered another function than {request[0]}")
    if request[0] in _ECHOED and reply[:5] != request[:5]:
        raise WireError(f"{where} confirmed another write than the one that was sent")
    if request[0] in _READ:
        count = struct.unpack(">H", request[3:5])[0]
        asked = -(-count // 8) if request[0] in (1, 2) else 2 * count
        if reply == request:
            raise WireError(f"{where} sends the request back (an echo), and no value")
        if len(reply) != 2 + asked or reply[1] != asked:
            raise WireError(f"{where} answered {len(reply) - 2} bytes of values where {asked} were asked")
    return reply


def crc16(data: bytes) -> bytes:
    """Return the CRC of an RTU frame, low byte first (Modbus over serial line V1.02, 6.2.2)."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return value.to_bytes(2, "little")


def _connected(plan: dict[str, Any]) -> socket.socket:
    """Return a connection to the first address of the plan that answers; raises OSError."""
    failure = OSError(f"{plan['host']} has no address")
    for address in plan["addresses"]:
        try:
            return socket.create_connection((address, plan["port"]), timeout=CONNECT_S)
        except OSError as error:
            failure = error
    raise failure


def _secured(wire: socket.socket, plan: dict[str, Any]) -> socket.socket:
    """Return the TLS connection on `wire`; the files are those of the rig file."""
    import ssl  # 5 MB that only a TLS rig needs

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_verify_locations(plan["ca"])
    context.load_cert_chain(plan["certificate"], plan["key"], password=lambda: b"")
    try:
        return context.wrap_socket(wire, server_hostname=plan["host"])
    except OSError:
        wire.close()
        raise


def _open_line(plan: dict[str, Any]) -> int:
    """Return the descriptor of a serial line in raw mode, with the speed and character of the plan."""
    import termios

    line = os.open(plan["serial_port"], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        speed = getattr(termios, f"B{plan['baud']}", None)
        if speed is None:
            raise OSError(f"{plan['baud']} bit/s is no standard speed")
        character = termios.CS8 | termios.CREAD | termios.CLOCAL
        if plan["stop_bits"] == 2:
            character |= termios.CSTOPB
        if plan["parity"] != "none":
            character |= termios.PARENB | (termios.PARODD if plan["parity"] == "odd" else 0)
        controls = termios.tcgetattr(line)[6]
        # A driver that keeps no parity (a pseudo terminal, some adapters) refuses what changes nothing else. The engine
        # has set this line before, and spoken on it: a request as it is now is worth more than none.
        with contextlib.suppress(termios.error):
            termios.tcsetattr(line, termios.TCSANOW, [0, 0, character, 0, speed, speed, controls])
        termios.tcflush(line, termios.TCIOFLUSH)
    except (OSError, termios.error) as error:
        os.close(line)
        raise OSError(str(error)) from None
    return line
