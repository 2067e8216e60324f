"""Checks of a rig file across its sections: names, addresses, wires, heartbeat and interlocks."""

from __future__ import annotations

from typing import Any

from drivers.rig_file.bus_sections import CanBus, ModbusBusSection
from drivers.rig_file.interlock_specs import HeaterPowerSpec
from drivers.rig_file.model import Point, Rig
from drivers.rig_file.wires import device_of_bus, wire_of_bus
from drivers.signals import CodecError, column_name, encode

RESERVED_COLUMNS = frozenset(
    ("tick", "time_s", "wall_s", "latency_s", "quality", "source_time_s", "profile_s", "segment")
)
"""Columns that journals and records have besides those of the points."""
QUALITY_SUFFIX = "_quality"
"""End of the name of a column of qualities."""


def cross_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Return mistakes that concern more than one section, each with its place in the document and the remedy."""
    found: list[tuple[tuple[Any, ...], str]] = []
    names: dict[str, int] = {}
    taken = Layout()
    for index, point in enumerate(rig.point):
        place = ("point", index)
        if point.name in names:
            found.append(((*place, "name"), f"a second point is called {point.name!r}; names must differ"))
        names[point.name] = index
        bus = rig.bus.get(point.bus)
        if bus is None:
            found.append(((*place, "bus"), f"{point.name}: no bus {point.bus!r}; there is {', '.join(rig.bus)}"))
            continue
        if isinstance(bus, CanBus):
            if point.message is None or point.signal is None:
                found.append((place, f"{point.name}: a point on CAN needs message and signal, as in the DBC"))
            if point.access != "r":
                found.append(((*place, "access"), f"{point.name}: points on CAN are read only; take access out"))
            continue
        if point.table is None or point.address is None:
            found.append(
                (
                    place,
                    f"{point.name}: a point on Modbus needs table (holding, input, coil or discrete) and address",
                )
            )
            continue
        if (why := unwritable(point)) is not None:
            found.append(((*place, "table"), f"{point.name}: {why}"))
        found += [((*place, key), f"{point.name}: {what}") for key, what in misplaced(point, bus)]
        clash = taken.taken_by(point)
        if clash is not None:
            unit = "" if point.table in ("coil", "discrete") else " register"
            found.append(
                (
                    (*place, "address"),
                    f"{point.name}: {point.table}{unit} {clash[1]} is {clash[0]}'s already; correct one address",
                )
            )
        if point.is_setpoint and point.readback is not None:
            target = next((other for other in rig.point if other.name == point.readback), None)
            if target is None:
                found.append(((*place, "readback"), f"{point.name}: no point {point.readback!r} to read back"))
            elif target.unit != point.unit:
                found.append(
                    ((*place, "readback"), f"{point.name} is in {point.unit} but {target.name} in {target.unit}")
                )
    for name, bus in rig.bus.items():
        if bus.uptime is not None and not any(p.name == bus.uptime and p.bus == name for p in rig.point):
            found.append((("bus", name, "uptime"), f"bus {name}: no point {bus.uptime!r} on this bus for uptime"))
    found += _wire_checks(rig) + _message_checks(rig)
    if rig.heartbeat is not None:
        for key in ("point", "counter", "arm", "status", "watchdog"):
            named = getattr(rig.heartbeat, key)
            if named is None:
                continue
            if named not in names:
                found.append((("heartbeat", key), f"heartbeat: no point {named!r}; declare it or correct {key}"))
            elif key in ("point", "arm") and rig.get(named).access == "r":
                why = f"heartbeat: {named} is written to as {key}; give it access 'rw' or name another"
                found.append((("heartbeat", key), why))
    return found + _column_checks(rig) + _watchdog_checks(rig) + _interlock_checks(rig) + _alarm_checks(rig)


def _column_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Return points whose columns in journals, records and exports would be those of something else.

    Databases do not distinguish capital letters in the names of columns.
    """
    found: list[tuple[tuple[Any, ...], str]] = []
    first: dict[str, Point] = {}
    columns = {column_name(point.name, point.unit).lower() for point in rig.point}
    for index, point in enumerate(rig.point):
        column = column_name(point.name, point.unit)
        key, rated = column.lower(), column.lower().removesuffix(QUALITY_SUFFIX)
        owner = first.setdefault(key, point)
        why = ""
        if key in RESERVED_COLUMNS:
            why = f"records have a column {key!r} of their own"
        elif owner.name != point.name:
            why = f"its column {column!r} is also that of {owner.name}"
        elif rated != key and rated in columns:
            why = f"its column {column!r} is that of the quality of {first[rated].name if rated in first else rated}"
        if why:
            found.append((("point", index, "name"), f"{point.name}: {why}; rename the point"))
    return found


def _watchdog_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Return the mistake that prevents setting the time-out of the rig's watchdog, if any."""
    heartbeat, place = rig.heartbeat, ("heartbeat", "watchdog")
    if heartbeat is not None and heartbeat.watchdog is None and heartbeat.watchdog_s is not None:
        return [(("heartbeat", "watchdog_s"), "heartbeat: watchdog_s is written to a point; name it as watchdog")]
    point = next((p for p in rig.point if heartbeat is not None and p.name == heartbeat.watchdog), None)
    if point is None:
        return []
    if point.access == "r" or point.is_setpoint or point.unit != "s":
        return [(place, f"heartbeat: {point.name} must be in s, have access 'rw' and no limits, to hold a time-out")]
    seconds = rig.watchdog_s or 0.0
    if seconds < 2.0 * rig.period_s:
        return [
            (
                place,
                f"heartbeat: a watchdog of {seconds:g} s would cut the heater between two beats; "
                f"make watchdog_s (else abort_after_s) at least two periods, {2.0 * rig.period_s:g} s",
            )
        ]
    try:
        encode((seconds - point.offset) / point.scale, point.type, point.order)
    except CodecError as error:
        return [(place, f"heartbeat: {seconds:g} s cannot be written to {point.name}: raw {error}; shorten watchdog_s")]
    return []


def _wire_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Return mistakes of sections that share a wire and disagree on it, or that are the same device."""
    found: list[tuple[tuple[Any, ...], str]] = []
    wire, device = wire_of_bus(rig), device_of_bus(rig)
    for name, other in wire.items():
        for key in (
            "transport",
            "transaction",
            "frame_length",
            "connect_delay_s",
            "serial_baud",
            "parity",
            "stop_bits",
        ):
            ours, theirs = getattr(rig.bus[name], key, None), getattr(rig.bus[other], key, None)
            if ours != theirs:
                what = f"bus {name} has {key} {ours!r} and bus {other}, on the same wire, {theirs!r}; correct one"
                found.append((("bus", name, key), what))
    for name, twin in device.items():
        if twin == name:
            continue
        where = "on the same wire" if wire[name] == wire[twin] else "on one port of this machine"
        what = f"bus {name} and bus {twin} are the same device {where}{_spelled(rig, name, twin)}"
        found.append((("bus", name, "device_id"), f"{what}; make one section of both"))
    return found


def _spelled(rig: Rig, one: str, other: str) -> str:
    """Return both spellings of a wire that two sections write differently, in brackets."""
    for key in ("host", "serial_port"):
        ours, theirs = getattr(rig.bus[one], key, None), getattr(rig.bus[other], key, None)
        if ours != theirs:
            return f" ({key} {ours!r} and {theirs!r})"
    return ""


def _message_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Return mistakes of CAN message entries: not read, declared twice, or with frames in common."""
    found: list[tuple[tuple[Any, ...], str]] = []
    for bus, config in rig.bus.items():
        if not isinstance(config, CanBus):
            continue
        read = {point.message for point in rig.point if point.bus == bus}
        for number, entry in enumerate(config.message):
            place = ("bus", bus, "message", number, "name")
            if entry.name not in read:
                found.append((place, f"bus {bus}: no point has message = {entry.name!r}; correct name, or take it out"))
            for other in config.message[:number]:
                if entry.name == other.name:
                    found.append((place, f"bus {bus}: message {entry.name} is there twice; names must differ"))
                elif entry.match.overlaps(other.match):
                    what = (
                        f"bus {bus}: a frame could be both {other.name} ({other.match}) and {entry.name} "
                        f"({entry.match}); correct one, with a narrower mask or a source"
                    )
                    found.append((place, what))
    return found


def unwritable(point: Point) -> str | None:
    """Return the cause where a Modbus point cannot be written although its access demands it, else None."""
    if point.access == "r" or point.table not in ("input", "discrete"):
        return None
    which, other = ("input registers", "holding") if point.table == "input" else ("discrete inputs", "coil")
    return f"{which} cannot be written; use table '{other}'"


def misplaced(point: Point, bus: ModbusBusSection) -> list[tuple[str, str]]:
    """Return key and mistake of a Modbus point that its bus cannot carry."""
    first = point.address or 0
    last = first + point.width - 1
    found: list[tuple[str, str]] = []
    if last > 65535:
        found.append(("address", f"ends at {last} and the last address is 65535; correct the address or the type"))
    most = bus.max_read if point.access == "r" else min(bus.max_read, bus.max_write)
    if point.width > most:
        found.append(("type", f"{point.type} takes {point.width} registers and one request {most}; raise max_read"))
    for hole in bus.hole:
        if hole.table == point.table and first <= hole.last and hole.first <= last:
            found.append(("address", f"is in the hole {hole.first} to {hole.last} of its bus; correct one of them"))
    return found


class Layout:
    """Addresses and the points that use them. Bit fields may share registers where their bits differ."""

    def __init__(self) -> None:
        self._taken: dict[tuple[str, str, int], list[Point]] = {}

    def clash(self, point: Point) -> tuple[str, int] | None:
        """Return name and address of a point that has an address of this Modbus point already, or None."""
        first = point.address or 0
        for address in range(first, first + point.width):
            for other in self._taken.get((point.bus, str(point.table), address), ()):
                if other is not point and not _share(point, other):
                    return other.name, address
        return None

    def taken_by(self, point: Point) -> tuple[str, int] | None:
        """Take the addresses of a Modbus point; return name and address of a point that has one already, or None."""
        clash = self.clash(point)
        first = point.address or 0
        for address in range(first, first + point.width):
            self._taken.setdefault((point.bus, str(point.table), address), []).append(point)
        return clash


def _share(one: Point, other: Point) -> bool:
    if one.bits is None or other.bits is None:
        return False
    same = (one.address, one.type, one.order) == (other.address, other.type, other.order)
    return same and (one.bits[1] < other.bits[0] or other.bits[1] < one.bits[0])


def _alarm_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Return mistakes of alarms: points that do not exist or are not read."""
    polled = {point.name: point.is_polled for point in rig.point}
    return [
        (
            ("alarm", index, "point"),
            f"alarm: {spec.point} is not read on every tick (access = 'r'); correct point"
            if spec.point in polled
            else f"alarm: no point {spec.point!r}; declare it or correct point",
        )
        for index, spec in enumerate(rig.alarm)
        if not polled.get(spec.point)
    ]


def _interlock_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Return mistakes of interlocks: points that do not exist or are of the wrong kind."""
    found: list[tuple[tuple[Any, ...], str]] = []
    points = {point.name: point for point in rig.point}
    for index, spec in enumerate(rig.interlock):
        for key, name in spec.points.items():
            point, place = points.get(name), ("interlock", index, key)
            if point is None:
                found.append((place, f"{spec.kind}: no point {name!r}; declare it or correct {key}"))
            elif not (point.is_setpoint if key == "setpoint" else point.is_polled):
                what = "a set-point" if key == "setpoint" else "read on every tick (access = 'r')"
                found.append((place, f"{spec.kind}: {name} is not {what}; correct {key}"))
            elif isinstance(spec, HeaterPowerSpec) and point.readback is None:
                found.append((place, f"{spec.kind}: {name} has no readback to compare with; add one to the point"))
    return found
