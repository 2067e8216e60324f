"""Length of the gap of an interrupted run, by the wall clock and by the time since the machine's boot.

A wall clock jumps: NTP corrects it, a dead battery resets it, an operator sets it. CLOCK_BOOTTIME (clock_gettime(2))
counts from the boot through every suspend and is never set. Within one boot (same /proc/sys/kernel/random/boot_id,
random(4)) it therefore gives the gap exactly. After a restart only the wall clock is left. Its gap is then checked
against the time since the boot, which is a lower bound.
"""

from __future__ import annotations

import asyncio
import contextlib
import datetime
import platform
import re
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from drivers.signals import ConfigurationError
from hil.run.restore.resumption import RunPosition
from hil.run_folder import RunFolderError

KEY = "clock"
"""Key of the journal's `meta` table for the `ClockReading` of the newest segment, as plain data."""
CHECK_EVERY_S = 1.0
"""Interval of the checks for a jump of the wall clock, s: twice the journal's commit interval."""
JUMP_S = 1.0
"""Least jump of the wall clock that counts, s: a smaller one changes a gap by no more than one usual tick."""
LONG_GAP_S = 7 * 86400.0
"""Longest gap that is accepted without --gap, s. A rig that stood for a week is cold, and a clock that is wrong by
years is more frequent than a resume after a week."""
SLACK_S = 60.0
"""Tolerated difference between boot clock and wall clock, s: the first seconds of a boot, corrections by NTP."""


@dataclass(frozen=True, slots=True)
class ClockReading:
    """Wall clock, s since 1970, at the boot of this machine, with the boot's identity and the machine's name."""

    boot_id: str
    host: str
    wall_at_boot_s: float


class MetaTable(Protocol):
    """Part of a journal writer that keeps single entries."""

    def put_meta(self, key: str, value: Any) -> None:
        """Set one entry."""


def read_clocks() -> ClockReading | None:
    """Return the clocks of this machine; None where it has no boot clock or no boot id."""
    boot_s = since_boot_s()
    try:
        boot_id = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return None
    return None if boot_s is None else ClockReading(boot_id, platform.node(), time.time() - boot_s)


def since_boot_s() -> float | None:
    """Return the time since this machine's boot, suspends included, s; None where it has no such clock."""
    clock = getattr(time, "CLOCK_BOOTTIME", None)
    return None if clock is None else time.clock_gettime(clock)


@contextlib.asynccontextmanager
async def clocks_recorded(journal: MetaTable) -> AsyncIterator[None]:
    """Write the clocks to the journal now and, until the block ends, after every jump of the wall clock."""
    noted = _note(journal, None)
    watch = asyncio.create_task(_watch(journal, noted))
    try:
        yield
    finally:
        watch.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await watch


async def _watch(journal: MetaTable, noted: ClockReading | None) -> None:
    while noted is not None:
        await asyncio.sleep(CHECK_EVERY_S)
        noted = _note(journal, noted)


def _note(journal: MetaTable, before: ClockReading | None) -> ClockReading | None:
    now = read_clocks()
    if now is None or (before is not None and abs(now.wall_at_boot_s - before.wall_at_boot_s) < JUMP_S):
        return before
    journal.put_meta(KEY, {"boot_id": now.boot_id, "host": now.host, "wall_at_boot_s": now.wall_at_boot_s})
    return now


def with_gap(was: RunPosition, noted: Any, stated_s: float | None, announce: Callable[[str], None]) -> RunPosition:
    """Return `was` with the time of the interruption on the boot clock, where that is known.

    Parameters
    ----------
    was
        Position of the run at its last row.
    noted
        Entry `KEY` of its journal, None in an older one.
    stated_s
        Gap that a person stated, s; it is accepted as it is.
    announce
        Gets a warning where the wall clock was set since.

    Raises
    ------
    RunFolderError
        No gap is stated, and the gap by the clocks is negative, longer than `LONG_GAP_S`, or shorter
        than the time since a later boot.
    """
    now_s, clocks = since_boot_s(), read_clocks()
    if stated_s is not None:
        if now_s is not None:
            return replace(was, cut_boot_s=now_s - stated_s)
        return replace(was, wall_s=time.time() - stated_s)
    wall_gap_s = time.time() - was.wall_s
    before = _reading(noted)
    if before is not None and clocks is not None and now_s is not None and before.host == clocks.host:
        if before.boot_id == clocks.boot_id:
            cut_s = was.wall_s - before.wall_at_boot_s
            gap_s = now_s - cut_s
            if cut_s > 0.0:
                _require_plausible(was, gap_s)
                if abs(gap_s - wall_gap_s) > SLACK_S:
                    set_by = f"{_span(abs(wall_gap_s - gap_s))} {'forward' if wall_gap_s > gap_s else 'back'}"
                    announce(
                        f"WARNING: this machine's clock was set {set_by} since the cut; by its time since boot the gap "
                        f"is {_span(gap_s)}; if that is wrong, stop and state it with --gap"
                    )
                return replace(was, cut_boot_s=cut_s)
        elif wall_gap_s < now_s - SLACK_S:
            raise _gap_error(was, wall_gap_s, f"but the machine has been up for {_span(now_s)}")
    _require_plausible(was, wall_gap_s)
    return was


def _reading(noted: Any) -> ClockReading | None:
    try:
        return ClockReading(str(noted["boot_id"]), str(noted["host"]), float(noted["wall_at_boot_s"]))
    except (TypeError, KeyError, ValueError):
        return None


def _require_plausible(was: RunPosition, gap_s: float) -> None:
    if gap_s < -JUMP_S:
        raise _gap_error(was, gap_s, "which cannot be")
    if gap_s > LONG_GAP_S:
        raise _gap_error(was, gap_s, f"longer than {_span(LONG_GAP_S)}")


def _gap_error(was: RunPosition, gap_s: float, why: str) -> RunFolderError:
    cut, now = (_utc(wall_s) for wall_s in (was.wall_s, time.time()))
    sign = "-" if gap_s < 0 else ""
    return RunFolderError(
        f"by its clock the run was cut at {cut} and it is {now} now, a gap of {sign}{_span(abs(gap_s))}, {why}: check "
        "this machine's clock, or state how long the run has been down, such as --gap 12min"
    )


def _utc(wall_s: float) -> str:
    try:
        return datetime.datetime.fromtimestamp(wall_s, datetime.UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (OverflowError, ValueError, OSError):
        return f"{wall_s:g} s since 1970"


def _span(seconds: float) -> str:
    """Return a duration as text, in the largest unit that leaves at least two."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.4g} {unit}"
    return f"{seconds:.3g} s"


def duration_s(text: str) -> float:
    """Return the seconds of `90s`, `12min`, `2.5h` or `3d`; raises ConfigurationError."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?) ?(s|min|h|d)", text.strip())
    if match is None:
        raise ConfigurationError(f"--gap {text!r} is no duration; write 90s, 12min, 2.5h or 3d")
    return float(match[1]) * {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}[match[2]]
