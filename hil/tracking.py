"""The calibrators in a process of their own, so that none ever delays a tick.

Blocks of ticks go there over a pipe, predictions and calibrations come back and are journaled. In lockstep the engine
waits when the process falls behind; in real time blocks queue here instead. Results depend on the samples alone, not
on how they were cut into blocks or on timing, so a run in lockstep is reproducible.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import multiprocessing
import signal
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hil.journal import JournalWriter

if TYPE_CHECKING:
    from twin.calibrators import Calibration
    from twin.tracking import TwinTracker

MOST_OUTSTANDING = 4
START_TIMEOUT_S = 120.0
FINISH_TIMEOUT_S = 120.0

Block = tuple[list[int], list[float], list[list[float]]]


class TrackingError(Exception):
    """The calibrators could not start; the message says why."""


@dataclass(frozen=True, slots=True)
class TrackingConfig:
    """What the process needs: the twin file, the record columns of a row, which calibrators, the seed."""

    twin: Path
    columns: tuple[str, ...]
    calibrators: tuple[str, ...]
    seed: int = 0


@dataclass(slots=True)
class _Reply:
    ticks: list[int]
    time_s: list[float]
    outputs: dict[str, NDArray[np.float64]]
    calibrations: list[tuple[str, float, float, dict[str, Any]]]


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """RMSE in K per twin sensor: `rows[sensor][column]`, columns in reading order, and the sensors' noise."""

    columns: tuple[str, ...]
    rows: dict[str, tuple[float, ...]]
    noise_K: dict[str, float] = field(default_factory=dict)


def push(
    trackers: dict[str, TwinTracker], time_s: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]
) -> tuple[dict[str, NDArray[np.float64]], list[tuple[str, float, float, dict[str, Any]]]]:
    """Push one block through every tracker: outputs by twin name (`static` first) and finished windows."""
    outputs: dict[str, NDArray[np.float64]] = {}
    calibrations = []
    for name, tracker in trackers.items():
        inputs, measured = tracker.network.select(columns)
        update = tracker.push(time_s, inputs, measured)
        outputs.setdefault("static", update.static)
        outputs[name] = update.tracked
        calibrations += [(name, c.start_s, c.end_s, calibration_document(c)) for c in update.calibrations]
    return outputs, calibrations


def calibration_document(calibration: Calibration) -> dict[str, Any]:
    """A finished window as plain data for the journal: kind, cost, errors in K, parameters with standard errors."""
    errors = None
    if calibration.covariance is not None:
        variances = np.diag(calibration.covariance)
        spread = [math.sqrt(v) if v >= 0 else None for v in variances.tolist()]
        errors = dict(zip(calibration.values, spread, strict=True))
    return {
        "window": calibration.window,
        "kind": calibration.kind,
        "cost": _finite(calibration.cost),
        "rmse_K": _finite(calibration.error_K),
        "rmse_before_K": _finite(calibration.error_before_K),
        "sensors_K": {name: _finite(value) for name, value in calibration.rmse.items()},
        "calibrated": bool(calibration.calibrated),
        "parameters": dict(calibration.values),
        "standard_errors": errors,
        "frozen": list(calibration.frozen),
        "condition": None if calibration.condition is None else _finite(calibration.condition),
        "disturbed": calibration.disturbed,
        "disturbed_W": calibration.disturbed_W,
        "disturbed_interval90_W": calibration.disturbed_interval90_W,
        "disturbed_since_s": calibration.disturbed_since_s,
        "flags": list(calibration.flags),
        "evaluations": calibration.evaluations,
    }


def disturbance(document: dict[str, Any]) -> str | None:
    """What a calibration says of an unknown power in one of the rig's volumes, as a sentence, or None."""
    where, power, interval = (document.get(f"disturbed{end}") for end in ("", "_W", "_interval90_W"))
    if where is None or power is None:
        return None
    spread = f" ({interval[0]:.0f} to {interval[1]:.0f})" if interval is not None else ""
    since = document.get("disturbed_since_s")
    when = f" since {since / 3600:.2f} h" if since is not None else ""
    gives = "takes up" if power < 0 else "gives off"
    return f"{where} {gives} {abs(power):.0f} W{spread} that the twin does not know of{when}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def make_trackers(config: TrackingConfig) -> dict[str, TwinTracker]:
    """One tracker a calibrator; raises what the twin file's reader raises."""
    from twin.tracking import TwinTracker
    from twin.twinfile import load

    network = load(config.twin)
    return {name: TwinTracker(network, calibrator=name, seed=config.seed) for name in config.calibrators}


def track_arrays(
    trackers: dict[str, TwinTracker],
    time_s: NDArray[np.float64],
    columns: Mapping[str, NDArray[np.float64]],
    block_rows: int,
) -> Iterator[tuple[int, dict[str, NDArray[np.float64]], list[tuple[str, float, float, dict[str, Any]]]]]:
    """Push a whole record in blocks: yields how many samples are done, the block's outputs and finished windows."""
    for start in range(0, len(time_s), block_rows):
        rows = slice(start, min(start + block_rows, len(time_s)))
        block = {name: values[rows] for name, values in columns.items()}
        outputs, calibrations = push(trackers, time_s[rows], block)
        yield rows.stop, outputs, calibrations


def error_table(trackers: dict[str, TwinTracker]) -> ErrorTable:
    """The trackers' errors side by side: static, then per calibrator ahead (predicted) and fitted."""
    columns: list[str] = []
    rows: dict[str, list[float]] = {}
    noise: dict[str, float] = {}
    for name, tracker in trackers.items():
        first = not columns
        columns += (["static"] if first else []) + [f"{name} ahead", f"{name} fitted"]
        for sensor, row in tracker.table().items():
            cells = rows.setdefault(sensor, [])
            cells += ([row["static"]] if first else []) + [row["tracked"], row["fitted"]]
            noise[sensor] = row["noise"]
    return ErrorTable(tuple(columns), {sensor: tuple(cells) for sensor, cells in rows.items()}, noise)


def _serve(connection: Connection, config: TrackingConfig) -> None:
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # these belong to the engine, which ends this process in order
    try:
        trackers = make_trackers(config)
        connection.send("ready")
        while (block := connection.recv()) is not None:
            ticks, time_s, rows = block
            table = np.asarray(rows, dtype=np.float64)
            columns = {name: table[:, index] for index, name in enumerate(config.columns)}
            outputs, calibrations = push(trackers, np.asarray(time_s), columns)
            connection.send(_Reply(ticks, time_s, outputs, calibrations))
        connection.send(error_table(trackers))
    except (EOFError, BrokenPipeError):
        return
    except Exception as error:
        with contextlib.suppress(OSError):
            connection.send(error)


class TrackingProcess:
    """A `hil.engine.Publisher` that calibrates twins in another process and journals what comes back."""

    def __init__(self, config: TrackingConfig, journal: JournalWriter, *, wait: bool) -> None:
        self._config = config
        self._journal = journal
        self._wait = wait
        self._queue: deque[Block] = deque()
        self._outstanding = 0
        self._room = asyncio.Event()
        self._failure: str | None = None
        self._table: ErrorTable | None = None
        self._process: Any = None
        self._connection: Connection | None = None

    async def start(self) -> None:
        """Start the process and wait until its kernel is compiled; raises TrackingError."""
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._config), name="calibrators", daemon=True)
        self._process.start()
        theirs.close()
        ready = await asyncio.to_thread(self._first_answer)
        if ready != "ready":
            await self.close()
            raise TrackingError(f"the calibrators did not start: {ready}")
        asyncio.get_running_loop().add_reader(self._connection.fileno(), self._receive)

    def _first_answer(self) -> Any:
        assert self._connection is not None
        try:
            if self._connection.poll(START_TIMEOUT_S):
                return self._connection.recv()
        except EOFError:
            return "the process ended at once"
        return f"no answer within {START_TIMEOUT_S:g} s"

    async def publish(self, ticks: list[int], time_s: list[float], rows: list[list[float]]) -> None:
        """Hand over a block; in lockstep wait while the process is behind."""
        if self._failure is not None or self._connection is None:
            return
        self._queue.append((ticks, time_s, rows))
        self._pump()
        try:
            async with asyncio.timeout(FINISH_TIMEOUT_S):
                while self._wait and self._failure is None and len(self._queue) + self._outstanding > MOST_OUTSTANDING:
                    self._room.clear()
                    await self._room.wait()
        except TimeoutError:
            self._fail(f"no result within {FINISH_TIMEOUT_S:g} s")

    async def finish(self) -> ErrorTable | None:
        """Wait for all results and end the process; the error table, or None where the calibrators failed."""
        try:
            async with asyncio.timeout(FINISH_TIMEOUT_S):
                while self._failure is None and (self._queue or self._outstanding):
                    self._room.clear()
                    await self._room.wait()
                if self._failure is None and self._connection is not None:
                    self._connection.send(None)
                    while self._failure is None and self._table is None:
                        self._room.clear()
                        await self._room.wait()
        except TimeoutError:
            self._fail(f"no result within {FINISH_TIMEOUT_S:g} s")
        await self.close()
        return self._table

    @property
    def failure(self) -> str | None:
        """Why the calibrators stopped before the run did, or None."""
        return self._failure

    def _pump(self) -> None:
        assert self._connection is not None
        try:
            while self._queue and self._outstanding < MOST_OUTSTANDING:
                self._connection.send(self._queue.popleft())
                self._outstanding += 1
        except OSError as error:
            self._fail(str(error))

    def _receive(self) -> None:
        assert self._connection is not None
        try:
            message = self._connection.recv()
        except (EOFError, OSError):
            self._fail("the process ended")
            return
        if isinstance(message, _Reply):
            self._outstanding -= 1
            for twin, values in message.outputs.items():
                self._journal.twin_outputs(twin, message.ticks, message.time_s, values)
            for calibration in message.calibrations:
                self._journal.calibration(*calibration)
                name, _, end_s, document = calibration
                found = disturbance(document) if name == self._config.calibrators[0] else None
                if found is not None:
                    self._journal.event(message.ticks[-1], end_s, "WARN", f"{name}: {found}")
            self._pump()
        elif isinstance(message, ErrorTable):
            self._table = message
        else:
            self._fail(f"{type(message).__name__}: {message}")
        self._room.set()

    def _fail(self, why: str) -> None:
        if self._failure is None:
            self._failure = why
            self._journal.event(-1, 0.0, "ERROR", f"the calibrators stopped, the run goes on without them: {why}")
        if self._connection is not None:
            asyncio.get_running_loop().remove_reader(self._connection.fileno())
        self._room.set()

    async def close(self) -> None:
        """End the process; harmless when repeated."""
        if self._connection is not None:
            asyncio.get_running_loop().remove_reader(self._connection.fileno())
            self._connection.close()
            self._connection = None
        if self._process is not None:
            await asyncio.to_thread(self._process.join, 5.0)
            if self._process.is_alive():
                self._process.kill()
                await asyncio.to_thread(self._process.join)
            self._process.close()
            self._process = None
