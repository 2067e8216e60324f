"""Processor time of a tick at 10 Hz, by part: reads, checks, writes, journal, guardian, and the threads beside it.

The engine is given a clock, a connection, a journal and a guardian that count the processor time of their own calls. A
part is the time of the loop's thread between the beginning and the end of these calls; checks are what lies between the
question for the twins' residuals and the question whether the guardian lets the engine heat.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.bus import Clock
from drivers.rig import RigConnection
from drivers.rig_file import Rig
from drivers.signals import Snapshot
from hil.bench.measure import ReportTable
from hil.guardian import GuardianClient
from hil.journal import Header, JournalWriter
from hil.run.engine import MonotonicClock
from hil.run.interlocks import Residuals

WARM_UP_TICKS = 20
"""Ticks that do not count: plans of requests and caches are made on the first ones."""


@dataclass(slots=True)
class Counts:
    """Processor time in s since the warm-up: `parts` by name in the loop's thread, `threads` by name, `process` in all;
    `ticks` counts all ticks of the run."""

    ticks: int = 0
    parts: dict[str, float] = field(default_factory=dict)
    threads: dict[str, float] = field(default_factory=dict)
    process: float = 0.0
    _begun: tuple[float, dict[str, float]] | None = None

    def add(self, part: str, seconds: float) -> None:
        """Add processor time of the loop's thread to a part, once the warm-up is over."""
        if self._begun is not None:
            self.parts[part] = self.parts.get(part, 0.0) + seconds

    def tick(self) -> None:
        """Take note of a tick that begins."""
        self.ticks += 1
        if self.ticks <= WARM_UP_TICKS:
            return
        process, threads = time.process_time(), _thread_times()
        if self._begun is None:
            self._begun = process, threads
        self.process = process - self._begun[0]
        self.threads = {name: spent - self._begun[1].get(name, 0.0) for name, spent in threads.items()}


def _thread_times() -> dict[str, float]:
    """Return the processor time of each living thread of this process by its name, s."""
    found: dict[str, float] = {}
    for thread in threading.enumerate():
        if thread.ident is not None:
            spent = time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
            found[thread.name] = found.get(thread.name, 0.0) + spent
    return found


class CountedClock(MonotonicClock):
    """Clock of a run that counts its ticks."""

    def __init__(self, period_s: float, counts: Counts) -> None:
        super().__init__(period_s)
        self._counts = counts

    async def next_tick(self) -> int:
        """Sleep until the next tick is due; return it."""
        tick = await super().next_tick()
        self._counts.tick()
        return tick


class CountedConnection(RigConnection):
    """Connection that counts the processor time of reads and writes."""

    def __init__(self, rig: Rig, clock: Clock, counts: Counts) -> None:
        super().__init__(rig, clock)
        self._counts = counts

    async def read(self) -> Snapshot:
        """Read all polled points."""
        began = time.thread_time()
        snapshot = await super().read()
        self._counts.add("reads", time.thread_time() - began)
        return snapshot

    async def write(self, values: Mapping[str, float]) -> None:
        """Write engineering values by point name; raises a DriverError."""
        began = time.thread_time()
        await super().write(values)
        self._counts.add("writes", time.thread_time() - began)

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Return writable points as the devices hold them; raises a DriverError."""
        began = time.thread_time()
        found = await super().read_back(names)
        self._counts.add("read-back of set-points", time.thread_time() - began)
        return found


class CountedJournal(JournalWriter):
    """Journal that counts the processor time of handing rows over to its thread."""

    def __init__(self, path: Path, header: Header, counts: Counts) -> None:
        super().__init__(path, header)
        self._counts = counts

    def sample(
        self,
        tick: int,
        time_s: float,
        wall_s: float,
        latency_s: float,
        values: Sequence[float],
        quality: Sequence[int],
        source_time_s: Sequence[float],
    ) -> None:
        """Append one tick."""
        began = time.thread_time()
        super().sample(tick, time_s, wall_s, latency_s, values, quality, source_time_s)
        self._counts.add("journal, handed over", time.thread_time() - began)


class CountedGuardian(GuardianClient):
    """Guardian's client that counts its processor time, and where the checks of a tick begin and end."""

    def __init__(self, rig: Rig, log: Path, counts: Counts) -> None:
        super().__init__(rig, log)
        self._counts = counts
        self._checks_began: float | None = None

    def residuals(self) -> Residuals:
        """Return no residuals; the engine asks for them when its checks begin."""
        self._checks_began = time.thread_time()
        return {}

    def expect(self, within_s: float) -> None:
        """Beat, where that is due."""
        began = time.thread_time()
        super().expect(within_s)
        self._counts.add("guardian", time.thread_time() - began)

    def failure(self) -> str | None:
        """Return why the run has to end."""
        began = time.thread_time()
        found = super().failure()
        self._counts.add("guardian", time.thread_time() - began)
        return found

    def may_heat(self) -> bool:
        """Return whether the engine is sure to be in charge; its checks have ended."""
        began = time.thread_time()
        if self._checks_began is not None:
            self._counts.add("checks", began - self._checks_began)
            self._checks_began = None
        found = super().may_heat()
        self._counts.add("guardian", time.thread_time() - began)
        return found


def table(counts: Counts) -> ReportTable:
    """Return the processor time a tick, in ms and as a share of the process's; raises RuntimeError of a short run."""
    ticks = counts.ticks - WARM_UP_TICKS - 1
    if ticks < 1 or counts.process <= 0.0:
        raise RuntimeError(f"{counts.ticks} ticks are too few: the first {WARM_UP_TICKS} do not count; run for longer")
    main = counts.threads.get(threading.main_thread().name, 0.0)
    rest = main - sum(counts.parts.values())
    rows = [
        ("process in all", counts.process),
        ("loop's thread", main),
        *((f"  {part}", spent) for part, spent in sorted(counts.parts.items())),
        ("  rest: event loop, clock, outcome", rest),
        *(
            (f"thread {name}", spent)
            for name, spent in sorted(counts.threads.items())
            if name != threading.main_thread().name and spent > 0.0
        ),
    ]
    return ReportTable(
        "processor_time",
        "Processor time of the engine's process at 10 Hz, guarded, ms a tick",
        ("part", "ms a tick", "share"),
        tuple((name, 1e3 * spent / ticks, spent / counts.process) for name, spent in rows),
        (
            f"Means of {ticks} ticks; counting takes part of it. Another version is compared by its own run on the "
            "same machine, in turns: the requirement is a ratio of the process's time of 1.05 at most.",
        ),
    )
