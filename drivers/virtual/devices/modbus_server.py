"""Modbus ports of one or more devices, which close and open with their power: TCP or TLS, RTU over TCP, a line."""

from __future__ import annotations

import asyncio
import ssl
from pathlib import Path

from drivers.virtual.devices.modbus_protocol import Devices, ModbusConnection
from drivers.virtual.devices.rtu_protocol import PseudoLine, RtuConnection
from drivers.virtual.devices.supervision import listen, port_of


class ModbusServer:
    """Server of `devices` on `port`, on `rtu_port` and on a pseudo-terminal, where these are requested (0: any port).

    `name` stands in messages about a port that cannot be opened.
    """

    def __init__(
        self,
        devices: Devices,
        host: str,
        port: int | None,
        tls: ssl.SSLContext | None,
        rtu_port: int | None = None,
        name: str = "Modbus",
    ) -> None:
        self.port = port
        self._name = name
        self.rtu_port = rtu_port
        self.line: PseudoLine | None = None
        self._devices, self._host, self._tls = devices, host, tls
        self._tcp: set[ModbusConnection] = set()
        self._rtu: set[RtuConnection] = set()
        self._servers: list[asyncio.Server] = []

    def open_line(self) -> None:
        """Open the pseudo-terminal."""
        self.line = PseudoLine(self._devices)

    async def open(self) -> None:
        """Listen; on the same ports when it is opened again."""
        if self.port is not None:
            server = await listen(
                lambda: ModbusConnection(self._devices, self._tcp), self._host, self.port, self._name, self._tls
            )
            self._servers.append(server)
            self.port = port_of(server)
        if self.rtu_port is not None:
            server = await listen(
                lambda: RtuConnection(self._devices, self._rtu), self._host, self.rtu_port, f"{self._name} RTU"
            )
            self._servers.append(server)
            self.rtu_port = port_of(server)
        if self.line is not None:
            self.line.powered = True

    def close(self) -> None:
        """Close the ports and every connection; the serial line falls silent."""
        for server in self._servers:
            server.close()
        self._servers.clear()
        for connection in tuple(self._tcp):
            connection.close()
        for client in tuple(self._rtu):
            client.close()
        if self.line is not None:
            self.line.powered = False


def tls_context(certificate: Path, key: Path, ca: Path) -> ssl.SSLContext:
    """Return a context of TLS 1.2 or later that refuses clients without a certificate of `ca`.

    Source: Modbus/TCP Security protocol specification, 8.2 and 8.5.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.load_cert_chain(certificate, key)
    context.load_verify_locations(ca)
    context.verify_mode = ssl.CERT_REQUIRED
    return context
