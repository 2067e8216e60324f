"""Time of a run: ticks on a fixed grid, in real, scaled or lockstep time.

`now()` is rig time in seconds: what stamps arrivals and judges staleness, whatever the speed.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable
from typing import Protocol

from drivers.bus import steady_s
from drivers.signals import LinkError

LOCKSTEP_DEADLINE_S = 20.0
LONGEST_WAIT_S = 1.0
"""An operator's verb is obeyed on the next tick; no longer than this may it be off."""


class Clock(Protocol):
    """Ticks of one run. `overruns` counts how often one was late by more than a period, so that ticks were left out."""

    period_s: float
    overruns: int

    def now(self) -> float:
        """Return rig time, s."""

    async def start(self) -> None:
        """Fix the grid: tick 0 is due now."""

    def release(self) -> None:
        """Let the rig go on to the next tick: all set-points of this one are written."""

    async def next_tick(self) -> int:
        """Wait for the next tick and return its index; missed ticks are left out, never caught up in a burst."""

    def current_tick(self) -> int:
        """Return the index of the tick that is due now: a later one than of `next_tick` where its work took so long."""

    async def advance(self, at_most_s: float = math.inf) -> None:
        """Let one period of rig time pass, outside the grid; or `at_most_s` of it where time runs by itself."""

    async def wait(self) -> None:
        """Wait before a tick of a run that waits for a person: no faster than time goes for them."""

    async def close(self) -> None:
        """Let go of the rig's time."""


class MonotonicClock:
    """Ticks every `period_s / speed` seconds of wall time, without drift; a suspended machine's time counts."""

    def __init__(self, period_s: float, speed: float = 1.0) -> None:
        self.period_s = period_s
        self.overruns = 0
        self._speed = speed
        self._origin = steady_s()
        self._tick = -1
        self._first = 0

    def now(self) -> float:
        """Return rig time since the clock was made, s."""
        return (steady_s() - self._origin) * self._speed

    async def start(self) -> None:
        """Make tick 0 due now. Rig time goes on, so that arrivals stamped before stay in the past."""
        self._tick = int(self.now() / self.period_s)
        self._first = self._tick + 1

    def release(self) -> None:
        """Do nothing: the rig's time runs by itself."""

    async def next_tick(self) -> int:
        """Sleep until the next tick is due and return the tick that is due when the sleep is over.

        A process that was stopped, or a machine that was suspended, oversleeps: the row's time must be that of the
        values that are read now.
        """
        due = self._not_missed(self._tick + 1)
        wait = (due * self.period_s - self.now()) / self._speed
        await asyncio.sleep(max(wait, 0.0))
        self._tick = self._not_missed(due)
        return self._tick - self._first

    def _not_missed(self, due: int) -> int:
        """Return the tick `due`, or where it is late by more than a period the last one that has begun."""
        late = self.now() / self.period_s - due
        if late <= 1.0:
            return due
        self.overruns += 1
        return due + int(late)

    def current_tick(self) -> int:
        """Return the index of the tick that is due now."""
        due = int(self.now() / self.period_s)
        if due > self._tick:
            self.overruns += 1
            self._tick = due
        return self._tick - self._first

    async def advance(self, at_most_s: float = math.inf) -> None:
        """Sleep for one period, or for `at_most_s` of rig time."""
        await asyncio.sleep(min(self.period_s, at_most_s) / self._speed)

    async def wait(self) -> None:
        """Do nothing: ticks come no faster than they are due."""

    async def close(self) -> None:
        """Do nothing: no device is held."""


class _GrantLine(asyncio.Protocol):
    """Control port of the virtual rig: `step` out, `t 12.000` back."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport | None = None
        self._buffer = b""
        self._lines: list[bytes] = []
        self._waiter: asyncio.Future[None] | None = None
        self._lost = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        self._lines += lines
        self._wake()

    def connection_lost(self, exc: Exception | None) -> None:
        self._lost = True
        self._wake()

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)

    async def line(self) -> str:
        while not self._lines:
            if self._lost:
                raise LinkError("the virtual rig closed its control port; it has ended")
            self._waiter = asyncio.get_running_loop().create_future()
            try:
                async with asyncio.timeout(LOCKSTEP_DEADLINE_S):
                    await self._waiter
            except TimeoutError:
                raise LinkError(f"the virtual rig took no step within {LOCKSTEP_DEADLINE_S:g} s") from None
        return self._lines.pop(0).decode("ascii", "replace").strip()


class LockstepClock:
    """Clock that grants the virtual rig each step: a run is as fast as the machine, and the same every time.

    `pids` are the rig's processes, if they are on this machine and of this run.
    """

    def __init__(self, host: str, port: int, pids: Iterable[int] = ()) -> None:
        self.period_s = 1.0
        self.pids = tuple(pids)
        self.overruns = 0
        self._host, self._port = host, port
        self._line: _GrantLine | None = None
        self._granted = False
        self._now = 0.0
        self._tick = -1

    def now(self) -> float:
        """Return rig time of the step that was granted last, s."""
        return self._now

    async def connect(self) -> None:
        """Take over the rig's time; raises LinkError where the port does not answer as a virtual rig in lockstep."""
        loop = asyncio.get_running_loop()
        try:
            _, self._line = await loop.create_connection(_GrantLine, self._host, self._port)
        except OSError as error:
            raise LinkError(
                f"no virtual rig at {self._host}:{self._port} ({error}); start one with `hil rig`"
            ) from error
        greeting = await self._line.line()
        words = dict(word.split("=", 1) for word in greeting.split() if "=" in word)
        if words.get("mode") != "lockstep":
            raise LinkError(f"{self._host}:{self._port} is no virtual rig in lockstep: it said {greeting!r}")
        self.period_s = float(words["period"])
        self._now = float(words["t"])

    async def start(self) -> None:
        """Make the next tick tick 0."""
        self._tick = -1

    def release(self) -> None:
        """Grant one step."""
        assert self._line is not None and self._line.transport is not None
        if not self._granted:
            self._granted = True
            self._now += self.period_s
            self._line.transport.write(b"step\n")

    async def next_tick(self) -> int:
        """Wait until the granted step is done (and grant one, where nobody did)."""
        assert self._line is not None
        self.release()
        answer = await self._line.line()
        if not answer.startswith("t "):
            raise LinkError(f"the virtual rig refused a step: {answer}")
        self._now = float(answer[2:])
        self._granted = False
        self._tick += 1
        return self._tick

    def current_tick(self) -> int:
        """Return the index of the step that was granted last: no time passes between two of them."""
        return self._tick

    async def advance(self, at_most_s: float = math.inf) -> None:
        """Grant one step and wait for it: a step cannot be parted."""
        await self.next_tick()

    async def wait(self) -> None:
        """Wait a period of wall time: else hours would pass on the rig while an operator looks at it."""
        await asyncio.sleep(min(self.period_s, LONGEST_WAIT_S))

    async def close(self) -> None:
        """Let go of the rig's time; the rig goes on in real time."""
        if self._line is not None and self._line.transport is not None:
            self._line.transport.close()
            self._line = None
            await asyncio.sleep(0)
