"""Wires of Modbus: a socket, a serial line, TLS. Bytes in and out, nothing of the protocol.

Sockets and serial lines are read without asyncio's transports, so that a reply can be taken as soon as it is here: on
the machine of a virtual rig the event loop takes longer than the rig's answer. No other module imports pyserial. POSIX
only, as the rest of the project.
"""

from __future__ import annotations

import asyncio
import os
import select
import socket
import ssl
import termios
from collections.abc import Callable
from typing import Any, Protocol

import serial

from drivers.rig_file import ModbusBusSection, ModbusRtuBus, ModbusTcpBus

_PARITY = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}
_MOST = 4096

Received = Callable[[bytes], None]
Lost = Callable[[str], None]


class Wire(Protocol):
    """Open wire. The event loop hands over the bytes that arrive; an end is reported once, with its reason."""

    def send(self, data: bytes) -> None:
        """Send all of `data`; raise OSError."""

    def take(self, seconds: float) -> bytes:
        """Return bytes that arrive within `seconds`, without the event loop; none where that is not possible."""

    def close(self) -> None:
        """Close; harmless when repeated."""


class DescriptorWire:
    """Socket or serial port, by its file descriptor."""

    def __init__(self, file: socket.socket | serial.Serial, received: Received, lost: Lost) -> None:
        self._file = file
        self._descriptor = file.fileno()
        self._received = received
        self._lost = lost
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._descriptor, self._readable)
        self._poll = select.poll()
        self._poll.register(self._descriptor, select.POLLIN)
        self._open = True

    def send(self, data: bytes) -> None:
        """Send a frame; raise OSError. A frame is small: a wire that does not take all of it took none before."""
        if not self._open:  # the number of a closed descriptor may be another file's by now
            raise OSError("the wire is closed")
        if os.write(self._descriptor, data) != len(data):
            raise OSError("the wire takes nothing any more")

    def take(self, seconds: float) -> bytes:
        """Return bytes that arrive within `seconds`, which are whole milliseconds."""
        return self._read() if self._open and self._poll.poll(1000.0 * seconds) else b""

    def close(self) -> None:
        """Close; harmless when repeated."""
        if self._open:
            self._open = False
            self._loop.remove_reader(self._descriptor)
            self._file.close()

    def _readable(self) -> None:
        data = self._read()
        if data:
            self._received(data)

    def _read(self) -> bytes:
        if not self._open:
            return b""
        try:
            data = os.read(self._descriptor, _MOST)
        except (BlockingIOError, InterruptedError):
            return b""
        except OSError as error:
            data, why = b"", str(error)
        else:
            why = "the other side has closed the connection"
        if not data:
            self.close()
            self._lost(why)
        return data


class _TlsWire(asyncio.Protocol):
    def __init__(self, received: Received, lost: Lost) -> None:
        self._received = received
        self._lost = lost
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        if self._transport is not None:
            self._received(data)

    def connection_lost(self, error: Exception | None) -> None:
        if self._transport is not None:
            self._transport = None
            self._lost(str(error) if error else "the other side has closed the connection")

    def send(self, data: bytes) -> None:
        if self._transport is None:
            raise OSError("the connection is closed")
        self._transport.write(data)

    def take(self, seconds: float) -> bytes:
        return b""

    def close(self) -> None:
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.abort()


async def open_wire(config: ModbusBusSection, tls: ssl.SSLContext | None, received: Received, lost: Lost) -> Wire:
    """Open and return the wire of a bus section; raise OSError (ssl.SSLError is one)."""
    if isinstance(config, ModbusRtuBus):
        return DescriptorWire(_serial_port(config), received, lost)
    assert isinstance(config, ModbusTcpBus)
    loop = asyncio.get_running_loop()
    if tls is not None:
        _, wire = await loop.create_connection(lambda: _TlsWire(received, lost), config.host, config.port, ssl=tls)
        return wire
    return DescriptorWire(await _connected(config.host, config.port), received, lost)


def _serial_port(config: ModbusRtuBus) -> serial.Serial:
    try:
        return serial.Serial(
            config.serial_port,
            config.serial_baud,
            bytesize=serial.EIGHTBITS,
            parity=_PARITY[config.parity],
            stopbits=config.stop_bits,
            timeout=0,
            write_timeout=0,
            exclusive=True,
        )
    except termios.error as error:
        raise OSError(
            f"the line does not take {config.serial_baud} bit/s with parity {config.parity!r} and {config.stop_bits} "
            f"stop bits ({error.args[-1]}); a pseudo terminal and some adapters take parity = 'none' only"
        ) from error


_Endpoint = tuple[socket.AddressFamily, socket.SocketKind, int, Any]
_reached: dict[tuple[str, int], _Endpoint] = {}
"""Endpoint at which a host was reached last: a reachable device must not depend on a name server that is gone."""


async def _connected(host: str, port: int) -> socket.socket:
    """Return a connection without Nagle's delay: to the endpoint that answered last, else to the host's first address
    that answers; raise OSError."""
    known = _reached.get((host, port))
    if known is not None:
        try:
            return await _to(known)
        except OSError:
            pass  # it may have moved
    failure: OSError = OSError(f"{host} has no address")
    found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM)
    for family, kind, protocol, _, address in found:
        try:
            wire = await _to((family, kind, protocol, address))
        except OSError as error:
            failure = error
        else:
            _reached[host, port] = family, kind, protocol, address
            return wire
    raise failure


async def _to(endpoint: _Endpoint) -> socket.socket:
    family, kind, protocol, address = endpoint
    wire = socket.socket(family, kind, protocol)
    try:
        wire.setblocking(False)
        wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        await asyncio.get_running_loop().sock_connect(wire, address)
    except BaseException:
        wire.close()
        raise
    return wire
