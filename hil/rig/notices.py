"""Notes on entries of a rig file that are allowed and probably not meant: a sentence each, with the line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from drivers.rig_file import ModbusTcpBus, Point, Rig, line_of, read_regular
from drivers.signals import HEATER, ROLES, nearest_role
from hil.run.outputs import SAFE_WITHIN_S, takes_s
from hil.run.restore import restore_obstacle, role_of, stores_heat


def notices(rig: Rig, file: Path) -> list[str]:
    """Return notes on heaters that stay on, unknown roles, unsafe set-ups, and a rig without thermal restore."""
    text = read_regular(file).decode("utf-8")
    found = []
    for index, point in enumerate(rig.point):
        for key, what in (("safe_value", _stays_on(rig, point)), ("role", _no_role(point))):
            if what is not None:
                found.append(f"{file}, line {line_of(text, ('point', index, key))}: {what}")
    if (
        any(stores_heat(point.as_signal()) for point in rig.point)
        and (what := restore_obstacle(rig, rig.setpoints)) is not None
    ):
        found.append(f"{file}: {what}")
    unlimited = _without_heartbeat(rig.unlimited, file) if rig.heartbeat is None and not rig.setpoints else []
    return [*found, *_entity_numbers(rig, file, text), *unlimited, *unguarded(rig, file)]


_ENTITY_NUMBERS = {"holding": 40000, "input": 30000, "discrete": 10000}
"""Offset of a table's entity numbers in manuals: 40001 is the first holding register, address 0."""
_NUMBERS_OF_A_TABLE = 10000
"""Entity numbers of a table, by the four digits after the leading one."""


def _entity_numbers(rig: Rig, file: Path, text: str) -> list[str]:
    """Return a note for every bus and table whose addresses look like numbers of a manual that count from 40001."""
    seen: dict[tuple[str, str], list[int]] = {}
    for index, point in enumerate(rig.point):
        first = _ENTITY_NUMBERS.get(str(point.table))
        if first is not None and point.address is not None and 0 <= point.address - first < _NUMBERS_OF_A_TABLE:
            seen.setdefault((point.bus, str(point.table)), []).append(index)
    found = []
    for (bus, table), indices in seen.items():
        names = ", ".join(rig.point[index].name for index in indices)
        first = _ENTITY_NUMBERS[table] + 1
        found.append(
            f"{file}, line {line_of(text, ('point', indices[0], 'address'))}: addresses of {names} in table {table} of "
            f"bus {bus} look like numbers of a manual, where {first} is the first one; addresses here count from zero, "
            f"so subtract {first} unless the device has them so high, as SunSpec devices do"
        )
    return found


def unguarded(rig: Rig, file: Path) -> list[str]:
    """Return notes on a rig with set-points but without heartbeat or without alarm."""
    if not rig.setpoints:
        return []
    found = []
    if rig.heartbeat is None:
        found += _without_heartbeat(rig.setpoints, file)
    if all(point.alarm is None for point in rig.point) and all(spec.level != "alarm" for spec in rig.interlock):
        found.append(
            f"{file}: no point has alarm limits and no [[interlock]] is an alarm, so that nothing trips the run when "
            "the rig gets too hot; give alarm to the points that show it"
        )
    return [*found, *_late_guardian(rig, file)]


def _without_heartbeat(written: Sequence[Point], file: Path) -> list[str]:
    """Return the note on points that the device keeps when this machine is gone, as no heartbeat is declared."""
    if not written:
        return []
    names = ", ".join(point.name for point in written)
    return [
        f"{file}: there is no [heartbeat], so that the device has no watchdog that hil knows: it keeps {names} "
        "when this machine loses power or hangs. The guardian process sets the safe values after `kill -9`, as "
        "long as this machine runs. Add [heartbeat] with the device's watchdog, or switch on a time-out in the "
        "device"
    ]


def _late_guardian(rig: Rig, file: Path) -> list[str]:
    """Return a note on each device that the guardian may reach late, because it takes no request after connecting."""
    found = []
    for name, bus in rig.bus.items():
        if not isinstance(bus, ModbusTcpBus) or all(point.bus != name for point in rig.setpoints):
            continue
        needs_s = takes_s(bus.connect_delay_s)
        if needs_s <= SAFE_WITHIN_S:
            continue
        found.append(
            f"{file}: bus {name} takes no request for connect_delay_s = {bus.connect_delay_s:g} s after connecting. "
            "The guardian process holds a connection of its own open; on a device that admits one connection only it "
            f"needs about {needs_s:g} s from `kill -9` or a hang to safe values: see that the device's own watchdog is "
            "shorter than that"
        )
    return found


def _stays_on(rig: Rig, point: Point) -> str | None:
    role = role_of(rig, point)
    # A set-point in W with another known role is a fan or a pump.
    is_heater = role == HEATER or (point.unit in ("W", "kW") and role not in ROLES)
    if not point.is_setpoint or not is_heater or not point.safe_value:
        return None
    if_so, remedy = ("it stays", "") if role == HEATER else ("a heater would stay", " if it heats")
    return (
        f"safe_value of {point.name} is {point.safe_value:g} {point.unit}, so that {if_so} on when a run is paused, "
        f"trips or ends; set safe_value = 0{remedy}"
    )


def _no_role(point: Point) -> str | None:
    if point.role is None or point.role in ROLES:
        return None
    return (
        f"role {point.role!r} of {point.name} is none that hil knows; did you mean "
        f"{nearest_role(point.role, point.unit)!r}? The known ones are {', '.join(ROLES)}; take role out if none "
        "fits: roles serve `hil resume`, the report and `hil review` alone, and a twin finds its columns by name"
    )
