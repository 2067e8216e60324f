"""Modbus client: link, wires, read planning and writes.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "budget": (
            "Polling",
            "counted",
            "missing_declarations",
            "overloads",
            "polling",
            "short_stale_times",
            "unit_of_count",
        ),
        "bus": ("ModbusBus",),
        "link": ("ModbusLink",),
        "read_plan": ("BIT_TABLES", "Block", "ReadPlan", "plan_reads", "plan_writes"),
        "tls": ("client_context",),
        "wire": ("Lost", "Received", "Wire", "open_wire"),
        "writes": ("Writes",),
    },
)
