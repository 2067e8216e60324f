"""Recorder of a run that goes on: rows of the journal, blocks for calibration, lines in the terminal."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Collection, Mapping
from typing import Protocol

from drivers.signals import Quality, Snapshot
from hil.journal import JournalError, JournalWriter, SegmentRow, Transition, event_level

_GOOD, _LOST = int(Quality.GOOD), int(Quality.LINK_FAULT)
PUBLISH_TICKS = 60
PUBLISH_WALL_S = 0.5
"""Ticks in a block that is handed to the publisher, and longest time until it is, s."""
BACKLOG_IN_LOCKSTEP = 2000
"""Rows in memory from which a run in lockstep waits for the journal."""
BEHIND_S = 1.0
"""Delay of the journal from which it is reported to be behind, s."""


def with_commands(
    snapshot: Snapshot, commanded: Mapping[str, float], unknown: Collection[str]
) -> tuple[list[float], list[int]]:
    """Return values and quality of a tick in the order of the journal's signals: readings, then commands.

    A command is no good value where the rig did not confirm it (`unknown`).
    """
    quality = snapshot.quality + [_LOST if name in unknown else _GOOD for name in commanded]
    return [*snapshot.values, *commanded.values()], quality


class Publisher(Protocol):
    """Receiver of blocks of ticks for calibration; must not delay a tick in real time."""

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        """Take a block: `rows (n, k)` in the order of the journal's signals, NaN where a value is not good."""


class Position:
    """Position of a run: `tick` since its beginning, gaps included, and ticks of the profile's clock."""

    def __init__(self, period_s: float, tick: int = 0, profile_s: float = 0.0) -> None:
        self.tick = tick
        self.profile_ticks = round(profile_s / period_s)
        self._period_s = period_s

    @property
    def time_s(self) -> float:
        """Return record time, s."""
        return self.tick * self._period_s

    @property
    def profile_s(self) -> float:
        """Return profile time, s."""
        return self.profile_ticks * self._period_s


class Recorder:
    """Recorder of what happens at `position`, in `journal`; it hands blocks of ticks to `publisher`.

    `announce` gets every transition as a sentence. `problems` are sentences about what could not be journaled.
    """

    def __init__(
        self,
        journal: JournalWriter,
        position: Position,
        *,
        publisher: Publisher | None = None,
        announce: Callable[[str], None] | None = None,
        lockstep: bool = False,
    ) -> None:
        self.problems: list[str] = []
        self._journal = journal
        self._at = position
        self._publisher = publisher
        self._announce = announce
        self._lockstep = lockstep
        self._pending: tuple[list[int], list[float], list[list[float]]] = ([], [], [])
        self._published = time.monotonic()
        self._behind = False
        self._silent: frozenset[int] | None = None

    @property
    def failure(self) -> str | None:
        """Why rows do not reach the disk any more; None while they do."""
        return self._journal.failure

    @property
    def silent(self) -> frozenset[int]:
        """Places of the points, in the order of the snapshots, that had no good value in any tick."""
        return self._silent or frozenset()

    def sample(
        self,
        snapshot: Snapshot,
        commanded: Mapping[str, float],
        now_s: float,
        wall_s: float,
        began: float,
        unknown: Collection[str] = (),
    ) -> None:
        """Append the tick: what was read, at `now_s` of rig time and `wall_s` of the wall clock, and what is commanded.
        `began` is when the tick's work began, of `perf_counter`. A set-point is no good value where the rig did not
        confirm it (`unknown`).

        Raises JournalError.
        """
        if self._silent is None or self._silent:
            places = range(len(snapshot.quality)) if self._silent is None else self._silent
            self._silent = frozenset(i for i in places if snapshot.quality[i] != _GOOD)
        values, quality = with_commands(snapshot, commanded, unknown)
        source = snapshot.source_time_s + [now_s] * len(commanded)
        latency = time.perf_counter() - began
        self._journal.sample(self._at.tick, self._at.time_s, wall_s, latency, values, quality, source)
        self._journal.check()
        behind = self._journal.behind_s > BEHIND_S
        if behind and not self._behind:
            self.event("WARN", "the journal is held by another program: rows wait in memory until it lets go")
        self._behind = behind
        if self._lockstep and self._journal.backlog > BACKLOG_IN_LOCKSTEP:
            self._journal.commit()  # nobody waits for a tick in lockstep, and memory has an end
        if self._publisher is None:
            return
        ticks, times, rows = self._pending
        ticks.append(self._at.tick)
        times.append(self._at.time_s)
        all_good = not any(quality)  # GOOD is 0
        rows.append(values if all_good else [v if q == 0 else math.nan for v, q in zip(values, quality, strict=True)])

    async def publish_if_due(self) -> None:
        """Hand on what has come together, often enough."""
        full = len(self._pending[0]) >= PUBLISH_TICKS
        late = not self._lockstep and time.monotonic() - self._published > PUBLISH_WALL_S
        if full or late:
            await self.flush()

    async def flush(self) -> None:
        """Hand on what has come together."""
        block, self._pending = self._pending, ([], [], [])
        self._published = time.monotonic()
        if self._publisher is not None and block[0]:
            await self._publisher.publish(*block)

    def written(self, before: Mapping[str, float], after: Mapping[str, float], reason: str) -> None:
        """Record the set-points that have changed, and why."""
        for name, value in after.items():
            if value != before[name]:
                self._journal.write(self._at.tick, self._at.time_s, name, value, reason)

    def transition(self, step: Transition) -> None:
        """Record a transition: a row of the journal, an event, a line in the terminal."""
        at = self._at
        self._journal.state(
            at.tick, at.time_s, at.profile_s, step.source.value, step.event.value, step.target.value, step.reason
        )
        self.event(event_level(step), f"{step.source} → {step.target}: {step.reason}")
        if self._announce is not None:
            # Nothing that a person sees may come between a fault and safe outputs.
            with contextlib.suppress(BaseException):
                self._announce(f"{at.time_s:8.0f} s  {step.target}: {step.reason}")

    def announce(self, level: str, text: str) -> None:
        """Record an event, and show it in the terminal."""
        self.event(level, text)
        if self._announce is not None:
            with contextlib.suppress(Exception):
                self._announce(f"{self._at.time_s:8.0f} s  {text}")

    def segment(self, number: int, gap_s: float, aim_tick: int, reason: str) -> None:
        """Record that the run goes on here after a gap; raises JournalError."""
        at = self._at
        self._journal.segment(
            SegmentRow(number, at.tick, at.time_s, time.time(), gap_s, at.profile_s, aim_tick, reason)
        )
        self.event(
            "WARN", f"segment {number}: goes on at {at.profile_s:g} s of the profile, {gap_s:g} s without a row before"
        )

    def event(self, level: str, text: str) -> None:
        """Record an event; a journal that fails must not keep the rig from being made safe."""
        try:
            self._journal.event(self._at.tick, self._at.time_s, level, text)
        except JournalError as error:
            self.problems.append(str(error))
