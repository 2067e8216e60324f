"""Map of the virtual rig's own firmware: recognizes rig files that describe it."""

from __future__ import annotations

from drivers.rig_file import CanBus, Point, Rig

_FLOAT = ("float32", "CDAB", 1.0)
_TENTH, _ONE = ("uint16", "", 0.1), ("uint16", "", 1.0)
_REGISTERS: dict[tuple[str, int], tuple[str, str, float]] = {
    **{("holding", address): _TENTH for address in (0, 1, 2, 4)},
    **{("holding", address): _ONE for address in (3, 5)},
    **{("input", address): _FLOAT for address in (0, 2)},
    **{("input", address): _TENTH for address in (4, 5)},
    ("input", 6): ("int16", "", 0.01),
    **{("input", address): _ONE for address in (7, 10, 11)},
    ("input", 8): ("uint32", "ABCD", 0.001),
    **{("discrete", address): ("bool", "", 1.0) for address in range(3)},
    ("coil", 0): ("bool", "", 1.0),
}
"""Type, word order and scale of each register of `devices.registers`; an empty order is that of a single register."""
_MESSAGES = ("TC_A", "TC_B", "TC_C")


def is_own_rig(rig: Rig) -> bool:
    """Return True where a rig file describes the virtual rig itself: its transports, its registers, its messages."""
    modbus = [bus for bus in rig.bus.values() if not isinstance(bus, CanBus)]
    can = [bus for bus in rig.bus.values() if isinstance(bus, CanBus)]
    if any(bus.transport != "modbus_tcp" or bus.device_id != 1 for bus in modbus) or len(modbus) > 1 or len(can) > 1:
        return False
    if any(bus.transport != "socketcand" for bus in can):
        return False
    return all(_is_own(point, isinstance(rig.bus[point.bus], CanBus)) for point in rig.point)


def _is_own(point: Point, on_can: bool) -> bool:
    if on_can:
        return point.message in _MESSAGES
    known = _REGISTERS.get((str(point.table), point.address or 0))
    order = point.order if point.width > 1 or point.order in ("BADC", "DCBA") else ""
    return known == (point.type, order, point.scale) and point.offset == 0.0
