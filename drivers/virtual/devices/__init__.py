"""Devices of the virtual rig: PLC with Modbus server, CAN node, control port.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "modbus_protocol": ("ILLEGAL_ADDRESS", "ILLEGAL_FUNCTION", "ILLEGAL_VALUE", "ModbusConnection"),
        "registers": ("HEARTBEAT", "HEATER_SET", "PUMP_SET", "Registers", "THERMOSTAT_C", "WATCHDOG_TRIPPED"),
        "rtu_protocol": ("crc",),
        "socketcand": ("CanConnection", "CanHub"),
        "truth": ("Moment", "read_truth"),
    },
)
