"""Devices of the virtual rig: PLC with Modbus server, CAN node, control port.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.devices.modbus_protocol import (
        ILLEGAL_ADDRESS,
        ILLEGAL_FUNCTION,
        ILLEGAL_VALUE,
        ModbusConnection,
    )
    from drivers.virtual.devices.registers import (
        HEARTBEAT,
        HEATER_SET,
        PUMP_SET,
        THERMOSTAT_C,
        WATCHDOG_TRIPPED,
        Registers,
    )
    from drivers.virtual.devices.rtu_protocol import crc
    from drivers.virtual.devices.socketcand import CanConnection, CanHub
    from drivers.virtual.devices.truth import Moment, read_truth

_HOME = {
    "CanConnection": "drivers.virtual.devices.socketcand",
    "CanHub": "drivers.virtual.devices.socketcand",
    "HEARTBEAT": "drivers.virtual.devices.registers",
    "HEATER_SET": "drivers.virtual.devices.registers",
    "ILLEGAL_ADDRESS": "drivers.virtual.devices.modbus_protocol",
    "ILLEGAL_FUNCTION": "drivers.virtual.devices.modbus_protocol",
    "ILLEGAL_VALUE": "drivers.virtual.devices.modbus_protocol",
    "ModbusConnection": "drivers.virtual.devices.modbus_protocol",
    "Moment": "drivers.virtual.devices.truth",
    "PUMP_SET": "drivers.virtual.devices.registers",
    "Registers": "drivers.virtual.devices.registers",
    "THERMOSTAT_C": "drivers.virtual.devices.registers",
    "WATCHDOG_TRIPPED": "drivers.virtual.devices.registers",
    "crc": "drivers.virtual.devices.rtu_protocol",
    "read_truth": "drivers.virtual.devices.truth",
}

__all__ = [
    "HEARTBEAT",
    "HEATER_SET",
    "ILLEGAL_ADDRESS",
    "ILLEGAL_FUNCTION",
    "ILLEGAL_VALUE",
    "PUMP_SET",
    "THERMOSTAT_C",
    "WATCHDOG_TRIPPED",
    "CanConnection",
    "CanHub",
    "ModbusConnection",
    "Moment",
    "Registers",
    "crc",
    "read_truth",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
