"""Other Modbus clients in Python, each used as its documentation shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Peer:
    """Client: `ask` reads `count` input registers of device 1."""

    ask: Callable[[], Any]
    close: Callable[[], object]


def pymodbus_sync(port: int, count: int) -> Peer:
    """Return pymodbus's blocking client."""
    from pymodbus.client import ModbusTcpClient

    client = ModbusTcpClient("127.0.0.1", port=port)
    client.connect()
    return Peer(lambda: client.read_input_registers(0, count=count, device_id=1), client.close)


async def pymodbus_async(port: int, count: int) -> Peer:
    """Return pymodbus's asyncio client."""
    from pymodbus.client import AsyncModbusTcpClient

    client = AsyncModbusTcpClient("127.0.0.1", port=port)
    await client.connect()
    return Peer(lambda: client.read_input_registers(0, count=count, device_id=1), client.close)


def py_modbus_tcp(port: int, count: int) -> Peer:
    """Return the client of pyModbusTCP; raise ImportError."""
    from pyModbusTCP.client import ModbusClient

    client = ModbusClient("127.0.0.1", port=port, unit_id=1)
    client.open()
    return Peer(lambda: client.read_input_registers(0, count), client.close)
