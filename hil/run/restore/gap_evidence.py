"""Evidence of how long a run was down: the wall clock, and where the machine did not restart the time since its boot.

A wall clock jumps: NTP corrects it, a dead battery resets it, an operator sets it. CLOCK_BOOTTIME (clock_gettime(2))
counts from the boot through every suspend and is never set, so within one boot (same
/proc/sys/kernel/random/boot_id, random(4)) it gives the gap exactly. After a restart only the wall clock is left; what
it says is then held against the time since the boot, which the run did not see.
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
from hil.run.restore.resumption import Standing
from hil.run_folder.folder import RunFolderError

KEY = "clock"
"""Of the journal's `meta` table: `ClockReading` as plain data, of the newest segment."""
LOOK_EVERY_S = 1.0
"""A wall clock that jumps is noticed within this time, twice the journal's commit interval."""
JUMP_S = 1.0
"""A wall clock that was set by less changes a gap by no more than a tick of the usual period."""
LONG_GAP_S = 7 * 86400.0
"""Longest gap that is believed unasked: a rig that stood for a week is cold, and a clock is more often wrong by years
than a run is resumed after a week."""
SLACK_S = 60.0
"""The clocks of a boot and of the wall may differ by so much without a cause: the first seconds of a boot, NTP."""


@dataclass(frozen=True, slots=True)
class ClockReading:
    """The wall clock, s since 1970, at the boot of this machine, with the boot's identity and the machine's name."""

    boot_id: str
    host: str
    wall_at_boot_s: float


class Meta(Protocol):
    """The part of a journal that keeps single entries."""

    def put_meta(self, key: str, value: Any) -> None:
        """Set one entry."""


def read_clocks() -> ClockReading | None:
    """Return what the clocks of this machine say now; None where it has no boot clock or no boot id."""
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
async def clocks_noted(journal: Meta) -> AsyncIterator[None]:
    """Note the clocks in the journal, now and for as long as the block lasts whenever the wall clock has jumped."""
    noted = _note(journal, None)
    watch = asyncio.create_task(_watch(journal, noted))
    try:
        yield
    finally:
        watch.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await watch


async def _watch(journal: Meta, noted: ClockReading | None) -> None:
    while noted is not None:
        await asyncio.sleep(LOOK_EVERY_S)
        noted = _note(journal, noted)


def _note(journal: Meta, before: ClockReading | None) -> ClockReading | None:
    now = read_clocks()
    if now is None or (before is not None and abs(now.wall_at_boot_s - before.wall_at_boot_s) < JUMP_S):
        return before
    journal.put_meta(KEY, {"boot_id": now.boot_id, "host": now.host, "wall_at_boot_s": now.wall_at_boot_s})
    return now


def with_gap(was: Standing, noted: Any, stated_s: float | None, announce: Callable[[str], None]) -> Standing:
    """Return `was` with the time of the cut on the boot clock, where that is known.

    Args:
        was: where the run stood.
        noted: entry `KEY` of its journal, None in an older one.
        stated_s: gap in seconds that a person stated, which is believed.
        announce: told where the wall clock is not believed.

    Raises:
        RunFolderError: the gap is negative, longer than `LONG_GAP_S`, or shorter than the time since a boot that the
            run did not see, and nobody has stated it.
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
                _refuse_if_odd(was, gap_s)
                if abs(gap_s - wall_gap_s) > SLACK_S:
                    set_by = f"{_span(abs(wall_gap_s - gap_s))} {'forward' if wall_gap_s > gap_s else 'back'}"
                    announce(
                        f"WARNING: this machine's clock was set {set_by} since the cut; by its time since boot the gap "
                        f"is {_span(gap_s)}; if that is wrong, stop and state it with --gap"
                    )
                return replace(was, cut_boot_s=cut_s)
        elif wall_gap_s < now_s - SLACK_S:
            raise _questioned(was, wall_gap_s, f"but the machine has been up for {_span(now_s)}")
    _refuse_if_odd(was, wall_gap_s)
    return was


def _reading(noted: Any) -> ClockReading | None:
    try:
        return ClockReading(str(noted["boot_id"]), str(noted["host"]), float(noted["wall_at_boot_s"]))
    except (TypeError, KeyError, ValueError):
        return None


def _refuse_if_odd(was: Standing, gap_s: float) -> None:
    if gap_s < -JUMP_S:
        raise _questioned(was, gap_s, "which cannot be")
    if gap_s > LONG_GAP_S:
        raise _questioned(was, gap_s, f"longer than {_span(LONG_GAP_S)}")


def _questioned(was: Standing, gap_s: float, why: str) -> RunFolderError:
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
    """Return a duration in the unit that fits."""
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
