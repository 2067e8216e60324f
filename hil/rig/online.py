"""Online check of a rig without writes (`hil check --online`): all faults as one tree, then the live points."""

from __future__ import annotations

import asyncio
import math
import signal
from typing import TYPE_CHECKING, Any

from drivers.rig import BusWatch, PointState, RigWatch
from drivers.rig_file import CanBus, Rig
from drivers.signals import Quality

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.tree import Tree

SHOWN_EVERY_S = 0.25
"""Interval of updates of the table, s."""
_AROUND = 7
"""Lines of the terminal for title, heading and frame of the table."""
_WIDE = 110
"""Columns of a terminal from which on the limits are shown."""
_STYLE = {Quality.GOOD: "green", Quality.STALE: "yellow", Quality.OUT_OF_RANGE: "yellow"}


async def watch_online(rig: Rig, seconds: float | None, out: Console | None) -> dict[str, Any]:
    """Open all buses, print the faults, show the points for `seconds` or until SIGINT, and return the last state.

    Parameters
    ----------
    rig
        The rig; nothing is written to it.
    seconds
        Time to show the points; None ends at once without a terminal.
    out
        Console, None to print nothing.
    """
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    try:
        async with RigWatch(rig) as watch:
            if out is not None:
                out.print(tree(watch))
            if seconds is None and (out is None or not out.is_terminal):
                seconds = 0.0
            await _show(watch, out, stop, seconds)
            return document(watch)
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)


async def _show(watch: RigWatch, out: Console | None, stop: asyncio.Event, seconds: float | None) -> None:
    from rich.live import Live

    end = math.inf if seconds is None else asyncio.get_running_loop().time() + seconds

    async def watched() -> bool:
        left = end - asyncio.get_running_loop().time()
        if left <= 0:
            return False
        try:
            await asyncio.wait_for(stop.wait(), min(SHOWN_EVERY_S, left))
        except TimeoutError:
            return True
        return False

    if out is None or not out.is_terminal:
        while await watched():
            pass
        if out is not None:
            out.print(table(watch))
        return
    rows, limits = max(out.height - _AROUND, 3), out.width >= _WIDE
    with Live(table(watch, rows, limits), console=out, auto_refresh=False) as live:
        while await watched():
            live.update(table(watch, rows, limits), refresh=True)


def tree(watch: RigWatch) -> Tree:
    """Return a tree of the buses with their faults."""
    from rich.text import Text
    from rich.tree import Tree

    faults = watch.faults()
    up = sum(bus.opened_s is not None for bus in watch.buses)
    root = Tree(Text(f"{watch.rig.name}: {up} of {len(watch.buses)} buses answer", style="red" if faults else "green"))
    for bus in watch.buses:
        sentences = faults.get(bus.name, [])
        branch = root.add(Text(_bus_line(watch.rig, bus), style="red" if sentences else "green"))
        for sentence in sentences:
            branch.add(Text(sentence))
    return root


def _bus_line(rig: Rig, bus: BusWatch) -> str:
    config = rig.bus[bus.name]
    where = config.place if isinstance(config, CanBus) else config.where
    count = len(bus.seen())
    state = "is down" if bus.opened_s is None else f"answers, opened in {1e3 * bus.opened_s:.0f} ms, {count} points"
    return f"{bus.name} ({where}): {state}"


def table(watch: RigWatch, rows: int | None = None, limits: bool = True) -> Table:
    """Return a table of the points now; of more than `rows`, those with a fault come first and the rest is counted."""
    from rich.table import Table
    from rich.text import Text

    shown = Table(title=f"{watch.rig.name}, nothing is written", title_justify="left", caption_justify="left")
    for heading in ("point", "raw", "value", "unit", "age", "quality", *(("limits",) if limits else ())):
        folds = heading in ("raw", "limits")
        right = heading in ("value", "age")
        shown.add_column(
            heading, justify="right" if right else "left", no_wrap=not folds, overflow="fold" if folds else "ellipsis"
        )
    found = watch.seen()
    if rows is not None and len(found) > rows:
        found.sort(key=lambda seen: seen.fault is None)
        shown.caption = f"and {len(found) - rows} more; a taller window shows all"
        found = found[:rows]
    for seen in found:
        beyond = seen.quality == Quality.GOOD and seen.fault is not None
        quality = Text(
            "never came" if not math.isfinite(seen.age_s) else "beyond alarm" if beyond else _words(seen.quality),
            style="red" if beyond else _STYLE.get(seen.quality, "red"),
        )
        last = (_limits(seen),) if limits else ()
        shown.add_row(seen.point.name, seen.raw, _value(seen), seen.point.unit, _age(seen.age_s), quality, *last)
    return shown


def _words(quality: Quality) -> str:
    return quality.name.lower().replace("_", " ")


def _value(seen: PointState) -> str:
    if seen.point.type == "string":
        return seen.text
    number = f"{seen.value:.6g}" if math.isfinite(seen.value) else "-"
    return f"{number} {seen.text}".rstrip()


def _age(age_s: float) -> str:
    return f"{age_s:.1f} s" if math.isfinite(age_s) else "-"


def _limits(seen: PointState) -> str:
    point = seen.point
    found = (("", point.limits), ("", point.plausible), ("alarm ", point.alarm))
    return ", ".join(f"{what}{limits[0]:g} to {limits[1]:g}" for what, limits in found if limits is not None)


def document(watch: RigWatch) -> dict[str, Any]:
    """Return buses, points and faults as plain data for JSON; unknown values are None."""

    def known(value: float) -> float | None:
        return round(value, 9) if math.isfinite(value) else None

    faults = watch.faults()
    return {
        "rig": watch.rig.name,
        "buses": {
            bus.name: {"open": bus.opened_s is not None, "opened_s": bus.opened_s, "faults": faults.get(bus.name, [])}
            for bus in watch.buses
        },
        "points": [
            {
                "name": seen.point.name,
                "bus": seen.point.bus,
                "raw": seen.raw,
                "value": known(seen.value),
                "text": seen.text,
                "unit": seen.point.unit,
                "age_s": known(seen.age_s),
                "quality": _words(seen.quality),
                "limits": seen.point.limits,
                "plausible": seen.point.plausible,
                "alarm": seen.point.alarm,
            }
            for seen in watch.seen()
        ],
        "faults": [sentence for sentences in faults.values() for sentence in sentences],
    }
