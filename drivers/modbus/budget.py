"""Load of a rig file's wires: bytes a tick and time on a serial line; declarations that it lacks. Pure, offline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.modbus.read_plan import BIT_TABLES, Block, plan_reads
from drivers.modbus.serial_line import BITS_PER_BYTE, silence_s
from drivers.rig_file import CanBus, ModbusBusSection, Point, Rig, is_rtu, wire_of_bus

MBAP_BYTES = 7
"""Header of a Modbus/TCP frame (Modbus messaging on TCP/IP implementation guide V1.0b, 3.1.3)."""
_RTU_BYTES = 3  # address and CRC


@dataclass(frozen=True, slots=True)
class Polling:
    """Load of one bus on every tick. `line_s` is the time on the line, s; None where no `serial_baud` is declared."""

    bus: str
    blocks: tuple[Block, ...]
    bytes_per_tick: int
    line_s: float | None


def polling(name: str, bus: ModbusBusSection, points: Sequence[Point]) -> Polling:
    """Return the read plan of a Modbus bus and its load."""
    blocks = plan_reads(
        (point for point in points if point.bus == name and point.is_polled),
        max_read=bus.max_read,
        max_gap=bus.max_gap,
        max_read_bits=bus.max_read_bits,
        holes=bus.hole,
    )
    pdu = [sum(block.read_bytes) for block in blocks]
    line_s = None
    if bus.serial_baud is not None:
        frames = sum(pdu) + 2 * _RTU_BYTES * len(pdu)
        line_s = frames * BITS_PER_BYTE / bus.serial_baud + 2 * len(pdu) * silence_s(bus.serial_baud)
    around = _RTU_BYTES if is_rtu(bus) else MBAP_BYTES
    return Polling(name, tuple(blocks), sum(pdu) + 2 * around * len(pdu), line_s)


def overloads(rig: Rig, polled: Sequence[Polling]) -> list[tuple[tuple[str, ...], str]]:
    """Return buses on which a tick's polling does not fit into the period, with place in the rig file and remedy."""
    found: list[tuple[tuple[str, ...], str]] = []
    wire = wire_of_bus(rig)
    for one in polled:
        bus = rig.bus[one.bus]
        if one.line_s is None or isinstance(bus, CanBus):
            continue
        sharing = [other for other in polled if wire.get(other.bus) == wire[one.bus]]
        line_s = sum(other.line_s or 0.0 for other in sharing)
        if line_s > rig.period_s / rig.time_scale:
            others = ", ".join(other.bus for other in sharing if other is not one)
            found.append(
                (
                    ("bus", one.bus, "serial_baud"),
                    f"bus {one.bus}{f' (with {others})' if others else ''}: a tick's reads take {line_s:.2f} s of a "
                    f"line at {bus.serial_baud} bit/s and the period is {rig.period_s / rig.time_scale:g} s; poll "
                    "fewer points, raise period_s or the speed of the line",
                )
            )
    return found


def missing_declarations(rig: Rig) -> list[str]:
    """Return a sentence for each optional declaration that the rig file lacks and that matters when something fails."""
    measured = [p for p in rig.point if p.is_polled and p.kind == "measured" and p.labels is None and p.type != "bool"]
    unlimited = [p.name for p in rig.unlimited]
    written = (*rig.setpoints, *rig.unlimited)
    groups = (
        (
            "no limits and no safe_value, so that no profile may drive them and no run makes them safe; give each "
            'limits, safe_value and max_rate, or kind = "status" if it is not to be driven',
            unlimited,
        ),
        (
            "no plausible range but that of the unit; give plausible = [low, high]",
            [p.name for p in measured if p.plausible is None],
        ),
        (
            "no max_rate, so that a profile may jump; give max_rate in the unit a second",
            [p.name for p in rig.setpoints if p.max_rate is None],
        ),
        (
            "no readback, so that hil does not see whether the actuator obeys; where it is measured, give "
            'readback = "NAME" of that point, in the same unit',
            [p.name for p in written if p.readback is None],
        ),
    )
    return [f"{what}: {', '.join(names)}" for what, names in groups if names] + _unwatched(rig)


def _unwatched(rig: Rig) -> list[str]:
    """Return the gaps of a heartbeat's watchdog: only the rig itself can cut the heater when the link is gone."""
    if not rig.setpoints or rig.heartbeat is None:
        return []
    if rig.watchdog_s is None:
        return [
            f"heartbeat has no watchdog, so that the rig's own time-out is not set from here: see that it is at most "
            f"abort_after_s, {rig.abort_after_s:g} s"
        ]
    if rig.watchdog_s > rig.abort_after_s:
        return [
            f"watchdog_s is {rig.watchdog_s:g} s, so that without a link the heater may be on for longer than "
            f"abort_after_s, {rig.abort_after_s:g} s"
        ]
    return []


def unit_of_count(block: Block) -> str:
    """Return the unit in which a block is counted: bit or register."""
    return "bit" if block.table in BIT_TABLES else "register"


def counted(count: int, what: str) -> str:
    """Return a count with its noun, in the plural where it is not 1: `1 read`, `2 reads`."""
    return f"{count} {what}" + ("" if count == 1 else "s")


def short_stale_times(rig: Rig, name: str, cycle_s: dict[str, float]) -> list[tuple[tuple[str | int, ...], str]]:
    """Return the points of a CAN bus that are stale before their next frame is due, with place and remedy.

    `cycle_s` is the DBC's cycle time of each message, s.
    """
    found: list[tuple[tuple[str | int, ...], str]] = []
    if not isinstance(rig.bus[name], CanBus):
        return found
    for index, point in enumerate(rig.point):
        due = cycle_s.get(point.message or "", 0.0)
        if point.bus == name and point.stale_after_s < due:
            found.append(
                (
                    ("point", index, "stale_after_s"),
                    f"{point.name}: is stale after {point.stale_after_s:g} s and {point.message} comes every {due:g} s "
                    f"by the DBC; give stale_after_s = {3 * due:g}",
                )
            )
    return found
