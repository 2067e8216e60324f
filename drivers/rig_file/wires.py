"""Bus sections of a rig file that share one wire or one device, also under different names of host or line.

Sections share a wire only where their host has an address in common and their port is the same. Two addresses of this
machine (`127.0.0.1` and `127.0.0.2`, or that of an interface) may have two servers behind one port. They keep a
connection each, and only count as one host where the same device would be driven twice (`device_of_bus`).
"""

from __future__ import annotations

import os
from functools import cache

from drivers.rig_file.bus_sections import CanBus, ModbusBusSection, ModbusRtuBus, ModbusTcpBus
from drivers.rig_file.host_address import addresses, is_own
from drivers.rig_file.model import Rig

_known = cache(addresses)
"""Addresses by host: all parts of one process must agree on the wires of a rig, and each name is resolved once."""


def serial_device(path: str) -> str:
    """Return the device file behind a serial port's path: udev gives one line several, /dev/serial/by-id/..."""
    return os.path.realpath(path)


def wire_of_bus(rig: Rig) -> dict[str, str]:
    """Return the wire of each Modbus section, as the name of the first section on it.

    Host names are resolved only where two sections with the same port give their host in different words. May wait for
    a name server then.
    """
    found: dict[str, str] = {}
    for name, bus in _modbus(rig).items():
        same = (other for other in found if found[other] == other and _share(rig, bus, other))
        found[name] = next(same, name)
    return found


def device_of_bus(rig: Rig) -> dict[str, str]:
    """Return the device of each Modbus section, as the name of the first section that reaches it.

    Beside sections of one wire with the same `device_id`, sections with the same port at any two addresses of this
    machine are one device.
    """
    wire, found = wire_of_bus(rig), dict[str, str]()
    for name, bus in _modbus(rig).items():
        same = (
            other
            for other in found
            if bus.device_id == _modbus(rig)[other].device_id
            and (wire[name] == wire[other] or _both_here(bus, _modbus(rig)[other]))
        )
        found[name] = next(same, name)
    return found


def _modbus(rig: Rig) -> dict[str, ModbusBusSection]:
    return {name: bus for name, bus in rig.bus.items() if not isinstance(bus, CanBus)}


def _share(rig: Rig, one: ModbusBusSection, name: str) -> bool:
    other = rig.bus[name]
    if isinstance(one, ModbusRtuBus) and isinstance(other, ModbusRtuBus):
        return serial_device(one.serial_port) == serial_device(other.serial_port)
    if not isinstance(one, ModbusTcpBus) or not isinstance(other, ModbusTcpBus) or one.port != other.port:
        return False
    return one.host == other.host or not set(_known(one.host)).isdisjoint(_known(other.host))


def _both_here(one: ModbusBusSection, other: ModbusBusSection) -> bool:
    """Return True for two sections with one port of this machine."""
    if not isinstance(one, ModbusTcpBus) or not isinstance(other, ModbusTcpBus) or one.port != other.port:
        return False
    return all(any(map(is_own, _known(bus.host))) for bus in (one, other))
