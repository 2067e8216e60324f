"""Modbus client: link, wires, read planning and writes.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.modbus.budget import (
        Polling,
        counted,
        missing_declarations,
        overloads,
        polling,
        short_stale_times,
        unit_of_count,
    )
    from drivers.modbus.bus import ModbusBus
    from drivers.modbus.link import ModbusLink
    from drivers.modbus.read_plan import BIT_TABLES, Block, ReadPlan, plan_reads, plan_writes
    from drivers.modbus.tls import client_context
    from drivers.modbus.wire import Lost, Received, Wire, open_wire
    from drivers.modbus.writes import Writes

_HOME = {
    "BIT_TABLES": "drivers.modbus.read_plan",
    "Block": "drivers.modbus.read_plan",
    "Lost": "drivers.modbus.wire",
    "ModbusBus": "drivers.modbus.bus",
    "ModbusLink": "drivers.modbus.link",
    "Polling": "drivers.modbus.budget",
    "ReadPlan": "drivers.modbus.read_plan",
    "Received": "drivers.modbus.wire",
    "Wire": "drivers.modbus.wire",
    "Writes": "drivers.modbus.writes",
    "client_context": "drivers.modbus.tls",
    "counted": "drivers.modbus.budget",
    "missing_declarations": "drivers.modbus.budget",
    "open_wire": "drivers.modbus.wire",
    "overloads": "drivers.modbus.budget",
    "plan_reads": "drivers.modbus.read_plan",
    "plan_writes": "drivers.modbus.read_plan",
    "polling": "drivers.modbus.budget",
    "short_stale_times": "drivers.modbus.budget",
    "unit_of_count": "drivers.modbus.budget",
}

__all__ = [
    "BIT_TABLES",
    "Block",
    "Lost",
    "ModbusBus",
    "ModbusLink",
    "Polling",
    "ReadPlan",
    "Received",
    "Wire",
    "Writes",
    "client_context",
    "counted",
    "missing_declarations",
    "open_wire",
    "overloads",
    "plan_reads",
    "plan_writes",
    "polling",
    "short_stale_times",
    "unit_of_count",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
