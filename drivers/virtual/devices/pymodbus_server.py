"""Modbus ports of the PLC served by pymodbus, in place of the project's own server.

It is a second server of the same registers, so that the driver is tested against foreign protocol code. It is slower
and answers only the first of several requests in one segment. A serial line stays with the project's own server.
"""

from __future__ import annotations

import errno
import ssl
from collections.abc import Sequence

from pymodbus.constants import ExcCodes
from pymodbus.exceptions import NoSuchIdException
from pymodbus.framer import FramerType
from pymodbus.server import ModbusTcpServer, ModbusTlsServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.virtual.devices.modbus_protocol import DEVICE_ID
from drivers.virtual.devices.registers import ARM, ARMED, COIL_COUNT, HOLDING_COUNT, INPUT_COUNT, STATUS_BITS, Registers
from drivers.virtual.devices.rtu_protocol import PseudoLine
from drivers.virtual.devices.supervision import port_refused

_PLACEHOLDER = SimDevice(DEVICE_ID, simdata=[SimData(0, datatype=DataType.REGISTERS, values=0)])
_COILS = frozenset({1, 5, 15})
_DISCRETE = frozenset({2})
_INPUTS = frozenset({4})


class RegistersContext:
    """Datastore of pymodbus's server whose values are those of the PLC."""

    def __init__(self, registers: Registers) -> None:
        self._registers = registers

    def device_ids(self) -> list[int]:
        """Return the number of the only device."""
        return [DEVICE_ID]

    async def async_getValues(
        self, device_id: int, function: int, address: int, count: int = 1
    ) -> list[int] | list[bool] | ExcCodes:
        """Return registers or bits, or the exception of a request outside of the map."""
        _require(device_id)
        if address + count > _size(function):
            return ExcCodes.ILLEGAL_ADDRESS
        registers = self._registers
        if function in _INPUTS:
            words = registers.inputs[2 * address : 2 * (address + count)]
            return [int.from_bytes(words[at : at + 2], "big") for at in range(0, len(words), 2)]
        if function in _COILS | _DISCRETE:
            bits = registers.status & ARMED if function in _COILS else registers.status
            return [bool(bits >> at & 1) for at in range(address, address + count)]
        return registers.holding[address : address + count]

    async def async_setValues(
        self, device_id: int, function: int, address: int, values: Sequence[int] | Sequence[bool]
    ) -> ExcCodes | None:
        """Write registers or the arming coil; return the exception where the PLC refuses."""
        _require(device_id)
        if address + len(values) > _size(function):
            return ExcCodes.ILLEGAL_ADDRESS
        at = ARM if function in _COILS else address
        return None if self._registers.write(at, [int(value) for value in values]) else ExcCodes.ILLEGAL_VALUE


def _require(device_id: int) -> None:
    if device_id != DEVICE_ID:
        raise NoSuchIdException(f"device {device_id} is not served")


def _size(function: int) -> int:
    if function in _COILS:
        return COIL_COUNT
    if function in _DISCRETE:
        return STATUS_BITS
    return INPUT_COUNT if function in _INPUTS else HOLDING_COUNT


class PymodbusServer:
    """Server of `registers` on `port`, and on `rtu_port` where requested, like `modbus_server.ModbusServer`."""

    def __init__(
        self, registers: Registers, host: str, port: int, tls: ssl.SSLContext | None, rtu_port: int | None = None
    ) -> None:
        self.port = port
        self.rtu_port = rtu_port
        self.line: PseudoLine | None = None
        self._registers, self._host, self._tls = registers, host, tls
        self._servers: list[ModbusTcpServer] = []

    def open_line(self) -> None:
        """Open the pseudo-terminal."""
        self.line = PseudoLine({DEVICE_ID: self._registers})

    async def open(self) -> None:
        """Listen; on the same ports when it is opened again. A port that cannot be had ends the process."""
        self.port = await self._listen(self.port, FramerType.SOCKET, self._tls)
        if self.rtu_port is not None:
            self.rtu_port = await self._listen(self.rtu_port, FramerType.RTU, None)
        if self.line is not None:
            self.line.powered = True

    async def _listen(self, port: int, framer: FramerType, tls: ssl.SSLContext | None) -> int:
        address = (self._host, port)
        if tls is None:
            server = ModbusTcpServer(_PLACEHOLDER, framer=framer, address=address)
        else:
            server = ModbusTlsServer(_PLACEHOLDER, framer=framer, address=address, sslctx=tls)
        server.context = RegistersContext(self._registers)  # type: ignore[assignment]
        try:
            await server.serve_forever(background=True)
        except RuntimeError as error:
            raise port_refused("Modbus", self._host, port, "is in use", errno.EADDRINUSE) from error
        self._servers.append(server)
        chosen: int = server.transport.sockets[0].getsockname()[1]  # type: ignore[attr-defined]
        return chosen

    def close(self) -> None:
        """Close the ports and every connection; the serial line falls silent."""
        for server in self._servers:
            server.close()
        self._servers.clear()
        if self.line is not None:
            self.line.powered = False
