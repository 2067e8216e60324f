"""Devices of the virtual rig: PLC with Modbus server, CAN node, control port.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.devices.control import ControlConnection
    from drivers.virtual.devices.modbus_protocol import (
        DEVICE_ID,
        ILLEGAL_ADDRESS,
        ILLEGAL_FUNCTION,
        ILLEGAL_VALUE,
        BitTable,
        Memory,
        ModbusConnection,
        RefusedRequest,
        RegisterTable,
    )
    from drivers.virtual.devices.modbus_server import ModbusServer
    from drivers.virtual.devices.registers import (
        HEARTBEAT,
        HEATER_SET,
        PUMP_SET,
        THERMOSTAT_C,
        WATCHDOG_TRIPPED,
        Registers,
    )
    from drivers.virtual.devices.rtu_protocol import crc
    from drivers.virtual.devices.socketcand import CanConnection, CanHub, frame_text
    from drivers.virtual.devices.supervision import end_with_parent, listen, port_of, say
    from drivers.virtual.devices.truth import Moment, read_truth

_HOME = {
    "BitTable": "drivers.virtual.devices.modbus_protocol",
    "CanConnection": "drivers.virtual.devices.socketcand",
    "CanHub": "drivers.virtual.devices.socketcand",
    "ControlConnection": "drivers.virtual.devices.control",
    "DEVICE_ID": "drivers.virtual.devices.modbus_protocol",
    "HEARTBEAT": "drivers.virtual.devices.registers",
    "HEATER_SET": "drivers.virtual.devices.registers",
    "ILLEGAL_ADDRESS": "drivers.virtual.devices.modbus_protocol",
    "ILLEGAL_FUNCTION": "drivers.virtual.devices.modbus_protocol",
    "ILLEGAL_VALUE": "drivers.virtual.devices.modbus_protocol",
    "Memory": "drivers.virtual.devices.modbus_protocol",
    "ModbusConnection": "drivers.virtual.devices.modbus_protocol",
    "ModbusServer": "drivers.virtual.devices.modbus_server",
    "Moment": "drivers.virtual.devices.truth",
    "PUMP_SET": "drivers.virtual.devices.registers",
    "RefusedRequest": "drivers.virtual.devices.modbus_protocol",
    "RegisterTable": "drivers.virtual.devices.modbus_protocol",
    "Registers": "drivers.virtual.devices.registers",
    "THERMOSTAT_C": "drivers.virtual.devices.registers",
    "WATCHDOG_TRIPPED": "drivers.virtual.devices.registers",
    "crc": "drivers.virtual.devices.rtu_protocol",
    "end_with_parent": "drivers.virtual.devices.supervision",
    "frame_text": "drivers.virtual.devices.socketcand",
    "listen": "drivers.virtual.devices.supervision",
    "port_of": "drivers.virtual.devices.supervision",
    "read_truth": "drivers.virtual.devices.truth",
    "say": "drivers.virtual.devices.supervision",
}

__all__ = [
    "DEVICE_ID",
    "HEARTBEAT",
    "HEATER_SET",
    "ILLEGAL_ADDRESS",
    "ILLEGAL_FUNCTION",
    "ILLEGAL_VALUE",
    "PUMP_SET",
    "THERMOSTAT_C",
    "WATCHDOG_TRIPPED",
    "BitTable",
    "CanConnection",
    "CanHub",
    "ControlConnection",
    "Memory",
    "ModbusConnection",
    "ModbusServer",
    "Moment",
    "RefusedRequest",
    "RegisterTable",
    "Registers",
    "crc",
    "end_with_parent",
    "frame_text",
    "listen",
    "port_of",
    "read_truth",
    "say",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
