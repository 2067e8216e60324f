"""Check of a rig file without the rig: points, interlocks, plan of the reads, and every mistake."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.can import CanReceiver
from drivers.modbus import (
    Polling,
    counted,
    missing_declarations,
    overloads,
    polling,
    short_stale_times,
    unit_of_count,
)
from drivers.rig_file import CanBus, Rig, load_rig, located
from hil.rig.notices import notices

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text


def checked_rig(file: Path) -> tuple[Rig, dict[str, Polling], dict[str, CanReceiver]]:
    """Return a rig, the polling load of its Modbus buses and the receivers of its CAN buses.

    Raises
    ------
    RigFileError
        The file has mistakes; the message names all of them.
    """
    rig = load_rig(file)
    polled: dict[str, Polling] = {}
    receivers: dict[str, CanReceiver] = {}
    mistakes: list[tuple[Sequence[Any], str]] = []
    for name, bus in rig.bus.items():
        if isinstance(bus, CanBus):
            mine = tuple(point for point in rig.point if point.bus == name)
            receivers[name] = CanReceiver(name, bus, mine, lambda: 0.0)  # matches every point with the DBC
            mistakes += short_stale_times(rig, name, receivers[name].cycle_s)
        else:
            polled[name] = polling(name, bus, rig.point)
    mistakes += overloads(rig, tuple(polled.values()))
    if mistakes:
        raise located(file, mistakes)
    return rig, polled, receivers


def show(file: Path, out: Console) -> None:
    """Print the content of the rig file to `out`; raises RigFileError with every mistake."""
    rig, polled, receivers = checked_rig(file)
    out.print(_points(rig))
    if rig.interlock:
        out.print(_interlocks(rig))
    if rig.alarm:
        out.print(_alarms(rig))
    for name, bus in rig.bus.items():
        out.print(_frames(receivers[name], bus) if isinstance(bus, CanBus) else _reads(rig, name, polled[name]))
    if rig.time_scale != 1.0:
        tick_s = rig.period_s / rig.time_scale
        out.print(f"the rig's clock runs {rig.time_scale:g} times real time: a tick every {tick_s:g} s of real time")
    if rig.watchdog_s is not None:
        out.print(f"the rig's own watchdog is set to {rig.watchdog_s:g} s when it is armed, and read back")
    for note in (*notices(rig, file), *missing_declarations(rig)):
        out.print(f"note: {note}", soft_wrap=True, markup=False)
    out.print(f"{file}: no mistakes found", style="green")


def _points(rig: Rig) -> Table:
    from rich.table import Table

    points = Table(title=f"{rig.name}: {counted(len(rig.point), 'point')}", title_justify="left")
    for heading in ("point", "bus", "where", "type", "unit", "limits", "safe", "plausible"):
        points.add_column(heading)
    for point in rig.point:
        where = f"{point.table} {point.address}" if point.table else f"{point.message}.{point.signal}"
        kind = f"{point.type} {point.order}" if point.table and point.width > 1 else point.type if point.table else ""
        if point.bits is not None:
            kind += f" bits {point.bits[0]}-{point.bits[1]}"
        limits = f"{point.limits[0]:g} to {point.limits[1]:g}" if point.limits else ""
        safe = f"{point.safe_value:g}" if point.safe_value is not None else ""
        plausible = f"{point.plausible[0]:g} to {point.plausible[1]:g}" if point.plausible else ""
        points.add_row(point.name, point.bus, where, kind, point.unit, limits, safe, plausible)
    return points


def _interlocks(rig: Rig) -> Table:
    from rich.table import Table

    table = Table(title=counted(len(rig.interlock), "interlock"), title_justify="left")
    for heading in ("kind", "level", "of", "what"):
        table.add_column(heading)
    shown = {"kind", "level", "doc", "point", "heater", "flow", "setpoint", "sensor"}
    for spec in rig.interlock:
        of = ", ".join(spec.points.values()) or getattr(spec, "sensor", "")
        bounds = spec.model_dump(exclude=shown, exclude_none=True)
        what = ", ".join(
            f"{key} {value}" if isinstance(value, str) else f"{key} {value:g}" for key, value in bounds.items()
        )
        table.add_row(spec.kind, spec.level, of, what)
    return table


def _alarms(rig: Rig) -> Table:
    from rich.table import Table

    table = Table(title=counted(len(rig.alarm), "alarm"), title_justify="left")
    for heading in ("of", "priority", "what"):
        table.add_column(heading)
    for spec in rig.alarm:
        bounds = spec.model_dump(exclude={"point", "priority", "latch", "doc"}, exclude_none=True)
        what = ", ".join(f"{key} {value:g}" for key, value in bounds.items())
        table.add_row(spec.point, spec.priority, f"{what}, latched" if spec.latch else what)
    return table


def _frames(receiver: CanReceiver, bus: CanBus) -> Text:
    from rich.text import Text

    often = ", ".join(f"{message} every {cycle:g} s" for message, cycle in receiver.cycle_s.items())
    signals = counted(len(receiver.points), "signal")
    masked = [f"{receiver.name}: {m.name} is {m.match}" for m in receiver.messages if not m.match.is_exact]
    masked += [
        f"note: {receiver.name}: {m.name} has the null source address of J1939 and the DBC does not call it J1939, so "
        f"that only {m.match} is read; for its PGN add a [[bus.{receiver.name}.message]]"
        for m in receiver.messages
        if m.match.looks_like_j1939
    ]
    first = f"{receiver.name}: {bus.place}, {signals} found in {bus.dbc.name}" + (f" ({often})" if often else "")
    return Text("\n".join((first, *masked)))


def _reads(rig: Rig, name: str, cost: Polling) -> Table:
    from rich.table import Table

    bus = rig.bus[name]
    assert not isinstance(bus, CanBus)
    line = "" if cost.line_s is None else f", {cost.line_s:.3f} s of the line at {bus.serial_baud} bit/s"
    reads = counted(len(cost.blocks), "read")
    table = Table(
        title=f"{name}: {bus.where}",
        title_justify="left",
        caption=f"{reads} and {cost.bytes_per_tick} bytes every {rig.period_s:g} s{line}",
        caption_justify="left",
    )
    for heading in ("read", "function", "count", "unused", "points", "bytes"):
        table.add_column(heading, justify="left" if heading == "read" else "right")
    for block in cost.blocks:
        count = counted(block.count, unit_of_count(block))
        cells = (block.unused, len(block.points), sum(block.read_bytes))
        table.add_row(str(block), str(block.read_code), count, *map(str, cells))
    return table


def as_json(file: Path) -> str:
    """Return the plan of the reads as JSON; raises RigFileError with every mistake."""
    rig, polled, receivers = checked_rig(file)
    plan = {
        name: {
            "bytes_per_tick": cost.bytes_per_tick,
            "line_s": cost.line_s,
            "reads": [
                {
                    "function": block.read_code,
                    "table": block.table,
                    "address": block.address,
                    "count": block.count,
                    "unused": block.unused,
                    "points": [point.name for point in block.points],
                }
                for block in cost.blocks
            ],
        }
        for name, cost in polled.items()
    }
    cycles = {name: receiver.cycle_s for name, receiver in receivers.items()}
    frames = {name: {m.name: str(m.match) for m in receiver.messages} for name, receiver in receivers.items()}
    found = {
        "rig": rig.name,
        "period_s": rig.period_s,
        "time_scale": rig.time_scale,
        "modbus": plan,
        "can_cycle_s": cycles,
        "can_frames": frames,
        "notes": [*notices(rig, file), *missing_declarations(rig)],
    }
    return json.dumps(found, indent=2)
