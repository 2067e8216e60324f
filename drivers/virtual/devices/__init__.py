"""Devices of the virtual rig: PLC with Modbus server, CAN node, control port.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.virtual.devices.control import ControlConnection, ControlledRig
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
    from drivers.virtual.devices.truth import Moment, last_moment, read_truth

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
    "ControlledRig",
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
    "last_moment",
    "listen",
    "port_of",
    "read_truth",
    "say",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "control": ("ControlConnection", "ControlledRig"),
        "modbus_protocol": (
            "BitTable",
            "DEVICE_ID",
            "ILLEGAL_ADDRESS",
            "ILLEGAL_FUNCTION",
            "ILLEGAL_VALUE",
            "Memory",
            "ModbusConnection",
            "RefusedRequest",
            "RegisterTable",
        ),
        "modbus_server": ("ModbusServer",),
        "registers": (
            "HEARTBEAT",
            "HEATER_SET",
            "PUMP_SET",
            "Registers",
            "THERMOSTAT_C",
            "WATCHDOG_TRIPPED",
        ),
        "rtu_protocol": ("crc",),
        "socketcand": (
            "CanConnection",
            "CanHub",
            "frame_text",
        ),
        "supervision": (
            "end_with_parent",
            "listen",
            "port_of",
            "say",
        ),
        "truth": (
            "Moment",
            "last_moment",
            "read_truth",
        ),
    },
)
