"""Calibrators in processes of their own, so that none ever delays a tick.

Blocks of ticks go there over a pipe, predictions and calibrations come back and are journaled. In lockstep the engine
waits when a process falls behind; in real time blocks queue here instead. Calibrators that fit share a process, those
with a network have another: a slow forward pass delays neither the engine nor them.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import signal
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from hil.tracking.child_process import Child, Sender
from hil.tracking.results import Results
from hil.tracking.twins import Comparison, PredictionBlock, Proposed, TrackingConfig, Twins, disturbance

MOST_OUTSTANDING = 4
START_TIMEOUT_S = 120.0
FINISH_TIMEOUT_S = 120.0
IDLE_AT_MOST_S = 5.0
"""Longest time in s without processor time before a process with a result due counts as stopped or hung. A process that
works is waited for: a fit may take a minute, and a loaded machine gives it some time in every second.
"""
IDLE_SHARE = 0.002
"""Share of one processor below which a process counts as idle."""
CLOSE_TIMEOUT_S = 5.0

Ticks = tuple[list[int], list[float], list[list[float]]]
GAP: Ticks = ([], [], [])
"""Mark in place of a block: the rig was not observed since the block before."""


class TrackingError(Exception):
    """Error of calibrators that could not start; the message states the reason."""


@dataclass(frozen=True, slots=True)
class _Ready:
    """Calibrators that the process runs, and those left out with the reason."""

    calibrators: tuple[str, ...]
    left_out: dict[str, str]


@dataclass(frozen=True, slots=True)
class _BlockReply:
    ticks: list[int]
    time_s: list[float]
    block: PredictionBlock


def _serve(connection: Connection, config: TrackingConfig) -> None:
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)  # These signals belong to the engine, which ends this process in order.
    try:
        twins = Twins(config)
        connection.send(_Ready(twins.calibrators, twins.left_out))
        while (ticks := connection.recv()) is not None:
            if ticks == GAP:
                twins.begin_again()
                continue
            numbers, time_s, rows = ticks
            table = np.asarray(rows, dtype=np.float64)
            columns = {name: table[:, index] for index, name in enumerate(config.columns)}
            connection.send(_BlockReply(numbers, time_s, twins.push(np.asarray(time_s), columns)))
        connection.send(twins.comparison())
    except (EOFError, BrokenPipeError):
        return
    except Exception as error:
        with contextlib.suppress(OSError):
            connection.send(error)


def _first_answer(connection: Connection) -> Any:
    try:
        if connection.poll(START_TIMEOUT_S):
            return connection.recv()
    except EOFError:
        return "the process ended at once"
    return f"no answer within {START_TIMEOUT_S:g} s"


class TrackingProcess:
    """Publisher (`hil.run.engine.engine.Publisher`) that calibrates twins in another process and journals the results.

    `wait`: whether it may keep the engine waiting, as in lockstep; `in_step`: for every block, so that what the engine
    reads from `off_K` depends on the samples alone. `speaks`: the calibrator of which disturbances become events, so
    that each is told once. `advise`: a sentence on a proposal, where there is something to say.
    """

    def __init__(
        self,
        config: TrackingConfig,
        *,
        wait: bool,
        in_step: bool = False,
        speaks: str = "",
        advise: Callable[[Proposed], str | None] | None = None,
    ) -> None:
        self._config = config
        self._wait = wait
        self._most = 0 if in_step else MOST_OUTSTANDING
        self.off_K: dict[tuple[str, str], float] = {}
        self._speaks = speaks
        self._advise = advise
        self._journal: Results | None = None
        self._queue: deque[Ticks] = deque()
        self._outstanding = 0
        self._room = asyncio.Event()
        self._failure: str | None = None
        self._comparison: Comparison | None = None
        self._child: Child | None = None
        self._sender: Sender | None = None
        self._ready = _Ready((), {})

    async def start(self) -> None:
        """Start the process and wait until its kernel is compiled.

        Raises
        ------
        TrackingError
            It does not come up. What a calibrator itself raises: see `Twins`.
        """
        self._child = Child(_serve, self._config, "calibrators")
        ready = await asyncio.to_thread(_first_answer, self._child.connection)
        if not isinstance(ready, _Ready):
            await self.close()
            if isinstance(ready, Exception):
                raise ready
            raise TrackingError(f"the calibrators did not start: {ready}")
        self._ready = ready
        self._child.listen(self._receive)
        loop = asyncio.get_running_loop()
        self._sender = Sender(self._child.connection, lambda why: loop.call_soon_threadsafe(self._fail, why))

    @property
    def calibrators(self) -> tuple[str, ...]:
        """Return the calibrators that run."""
        return self._ready.calibrators

    @property
    def left_out(self) -> dict[str, str]:
        """Return the optional calibrators that do not run, with the reason."""
        return self._ready.left_out

    @property
    def pid(self) -> int | None:
        """Return the id of the process while it lives."""
        return None if self._child is None else self._child.pid

    def attach(self, journal: Results) -> None:
        """Set the receiver of results; before the first block."""
        self._journal = journal

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        """Send a block; in lockstep wait while the process is behind."""
        if self._failure is not None or self._child is None:
            return
        self._queue.append((ticks, time_s, rows))
        self._pump()
        await self._until(lambda: not self._wait or len(self._queue) + self._outstanding <= self._most)

    def begin_again(self) -> None:
        """Restart after a time without observation: the next samples give the state of the rig."""
        self.off_K = {}
        if self._failure is None and self._child is not None:
            self._queue.append(GAP)
            self._pump()

    async def settled(self) -> None:
        """Wait for the results of all blocks sent; a process that takes too long counts as failed."""
        await self._until(self._is_caught_up)

    def _is_caught_up(self) -> bool:
        return not self._queue and not self._outstanding

    async def _until(self, condition: Callable[[], bool]) -> None:
        """Wait for results until `condition` is true; fail if the process is idle or takes too long."""
        loop = asyncio.get_running_loop()
        end_s = loop.time() + FINISH_TIMEOUT_S
        looked_s, worked_s = loop.time(), self._work_s()
        while self._failure is None and not condition():
            now_s = loop.time()
            if now_s > end_s:
                self._fail(f"no result within {FINISH_TIMEOUT_S:g} s")
            elif now_s - looked_s > IDLE_AT_MOST_S:
                if self._work_s() - worked_s < IDLE_SHARE * (now_s - looked_s):
                    self._fail(
                        f"its process did nothing for {now_s - looked_s:.0f} s (stopped by a signal, or it hangs) and "
                        "was ended; its results since then are missing"
                    )
                looked_s, worked_s = now_s, self._work_s()
            else:
                self._room.clear()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._room.wait(), min(IDLE_AT_MOST_S, 1.0))

    def _work_s(self) -> float:
        return math.nan if self._child is None else self._child.work_s()

    async def finish(self) -> Comparison | None:
        """Wait for all results, end the process and return the comparison of the twins, or None if the calibrators
        failed.
        """
        await self._until(self._is_caught_up)
        if self._failure is None and self._sender is not None:
            self._sender.put(None)
            await self._until(lambda: self._comparison is not None)
        await self.close()
        return self._comparison

    @property
    def failure(self) -> str | None:
        """Return the reason why the calibrators stopped before the run did, or None."""
        return self._failure

    def _pump(self) -> None:
        assert self._sender is not None
        while self._queue and self._outstanding < MOST_OUTSTANDING:
            ticks = self._queue.popleft()
            self._sender.put(ticks)
            self._outstanding += ticks != GAP

    def _receive(self) -> None:
        assert self._child is not None
        try:
            message = self._child.connection.recv()
        except (EOFError, OSError):
            self._fail("the process ended")
            return
        if isinstance(message, _BlockReply):
            self._outstanding -= 1
            self._write(message)
            self._pump()
        elif isinstance(message, Comparison):
            self._comparison = message
        else:
            self._fail(f"{type(message).__name__}: {message}")
        self._room.set()

    def _write(self, reply: _BlockReply) -> None:
        assert self._journal is not None
        journal, block = self._journal, reply.block
        self.off_K = block.off_K
        for twin, values in block.outputs.items():
            journal.twin_outputs(twin, reply.ticks, reply.time_s, values)
        for done in block.calibrations:
            journal.calibration(done.calibrator, done.start_s, done.end_s, done.document)
            found = disturbance(done.document) if done.calibrator == self._speaks else None
            if found is not None:
                journal.event(reply.ticks[-1], done.end_s, "WARN", f"{done.calibrator}: {found}")
        for proposed in block.proposals:
            journal.proposal(proposed.calibrator, proposed.time_s, proposed.document)
            said = None if self._advise is None else self._advise(proposed)
            if said is not None:
                journal.event(reply.ticks[-1], proposed.time_s, "INFO", said)
        for band in block.bands:
            journal.band(band.twin, band.start_s, band.end_s, asdict(band))

    def _fail(self, why: str) -> None:
        if self._failure is None:
            self._failure = why
            if self._journal is not None:
                who = ", ".join(self.calibrators)
                self._journal.event(-1, 0.0, "ERROR", f"{who}: stopped, the run goes on without: {why}")
        if self._child is not None:
            self._child.ignore()
            self._child.kill()
        self._room.set()

    async def close(self) -> None:
        """End the process; harmless when repeated."""
        child, self._child = self._child, None
        sender, self._sender = self._sender, None
        if child is not None:
            await child.end(CLOSE_TIMEOUT_S)
        if sender is not None:
            sender.end()


class Tracking:
    """Publisher of all calibrators of a run: the fits in one process, the network in another."""

    def __init__(
        self,
        config: TrackingConfig,
        *,
        wait: bool,
        in_step: bool = False,
        advise: Callable[[Proposed], str | None] | None = None,
    ) -> None:
        from twin.calibrators import UNTRAINED_CALIBRATORS

        fits = tuple(name for name in config.calibrators if name in UNTRAINED_CALIBRATORS)
        asks = tuple(name for name in config.calibrators if name not in UNTRAINED_CALIBRATORS)
        self._order = config.calibrators
        self._all = [
            TrackingProcess(
                replace(config, calibrators=names, static=first),
                wait=wait,
                in_step=in_step,
                speaks=names[0] if first else "",
                advise=advise,
            )
            for names, first in ((fits, True), (asks, not fits))
            if names
        ]

    async def start(self) -> None:
        """Start the processes at the same time; raise as `TrackingProcess.start` does, with none left running."""
        done = await asyncio.gather(*(process.start() for process in self._all), return_exceptions=True)
        for error in done:
            if isinstance(error, BaseException):
                await self.close()
                raise error

    @property
    def calibrators(self) -> tuple[str, ...]:
        """Return the calibrators that run, in the order in which they were named."""
        running = {name for process in self._all for name in process.calibrators}
        return tuple(name for name in self._order if name in running)

    def off_K(self) -> dict[tuple[str, str], float]:
        """Return (twin, sensor) -> mean of measured minus predicted over the latest block, K."""
        return {key: value for process in self._all for key, value in process.off_K.items()}

    @property
    def left_out(self) -> dict[str, str]:
        """Return the calibrators that do not run, with the reason."""
        return {name: why for process in self._all for name, why in process.left_out.items()}

    def attach(self, journal: Results) -> None:
        """Set the receiver of results; before the first block."""
        for process in self._all:
            process.attach(journal)

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        """Hand a block to every process."""
        for process in self._running():
            await process.publish(ticks, time_s, rows)

    def begin_again(self) -> None:
        """Inform every process that the rig was not observed since the last block."""
        for process in self._running():
            process.begin_again()

    async def settled(self) -> None:
        """Wait until every process has returned the results of all its blocks."""
        await asyncio.gather(*(process.settled() for process in self._running()))

    async def finish(self) -> Comparison | None:
        """Wait for all results; return the comparison of the twins, without those that failed."""
        found = await asyncio.gather(*(process.finish() for process in self._running()))
        whole = None
        for part in found:
            whole = part if whole is None else whole if part is None else whole.joined_with(part)
        return whole

    def _running(self) -> list[TrackingProcess]:
        return [process for process in self._all if process.calibrators]

    @property
    def processes(self) -> tuple[int, ...]:
        """Return the ids of the processes, that of the fits first."""
        return tuple(process.pid for process in self._all if process.pid is not None)

    @property
    def failures(self) -> list[str]:
        """Return a sentence for each process that stopped before the run did."""
        stopped = [process for process in self._all if process.failure is not None]
        return [f"{', '.join(process.calibrators)} stopped: {process.failure}" for process in stopped]

    async def close(self) -> None:
        """End all processes; harmless when repeated."""
        await asyncio.gather(*(process.close() for process in self._all))
