"""Stage of a chaos case: a virtual rig with or without its watchdog, `hil run` on it, and all targets of attacks.

Every process that the run starts carries a marker in its environment, by which the guardian is found, whatever started
it, and by which nothing is left behind.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path

from drivers.virtual import start_virtual_rig
from drivers.virtual.devices import last_moment
from drivers.virtual.faults import FaultyLink, can_frames, modbus_frames
from hil.bench.chaos.clock import SteppedClock
from hil.bench.chaos.device import LyingDevice
from hil.bench.chaos.terminal import Terminal
from hil.bench.faults import (
    FANS_PCT,
    LOAD,
    LOOK_EVERY_S,
    PERIOD_S,
    ROOT,
    WATCHDOG_S,
    Harness,
    OwnDisk,
    Stage,
    prepare,
    rig_text,
)
from hil.bench.measure import processes

WATCHDOG_OFF_S = 600.0
"""Time-out of a watchdog that never cuts within a case: the rig still takes heartbeats and arming."""
READBACK_WITHIN_S = 10.0
"""Time in s for measured values to follow: the heater's meter has a time constant, and a slow meter must not count as
unsafe. A lying device must not be given up at once either.
"""


class ChaosHarness(Harness):
    """Process `hil run` whose folder may be moved or deleted meanwhile."""

    known: Path | None = None

    def folder(self) -> Path | None:
        """Return the run's folder under its present name."""
        if self.known is None:
            self.known = Harness.folder(self)
        return self.known


@dataclass(slots=True)
class ChaosStage(Stage):
    """Targets of an attack."""

    terminal: Terminal | None = None
    device: LyingDevice | None = None
    clock: SteppedClock | None = None
    marker: str = ""
    stepped_s: float | None = None
    """Wall time of the step of the run's clock."""
    nobody: list[tuple[float, float]] = field(default_factory=list)
    """Intervals of wall time in which neither harness nor guardian could run or reach the rig."""
    foreign_s: float = -math.inf
    """Wall time at which another master last switched the heater on, s."""
    code: int | None = None
    """Exit code of the run; None if the campaign had to kill it."""
    destroyed: bool = False
    """True if the case has deleted the samples themselves."""
    helpers: list[subprocess.Popen[bytes]] = field(default_factory=list)
    leaks: list[socket.socket] = field(default_factory=list)
    undo: list[Callable[[], None]] = field(default_factory=list)
    """Steps before the verdict."""
    release: list[Callable[[], None]] = field(default_factory=list)
    """Steps after the heater is off: they release a run that would otherwise wait minutes for its record."""

    @property
    def place(self) -> Path:
        """Return the folder of the case."""
        return self.truth.parent

    def folder(self) -> Path:
        """Return the run's folder; raise RuntimeError if there is none."""
        found = self.harness.folder()
        if found is None:
            raise RuntimeError("the run has no folder yet")
        return found

    def descendants(self) -> list[int]:
        """Return the live processes that the run has started, without itself."""
        return [pid for pid in processes.marked(self.marker) if pid != self.pid]

    def guardians(self) -> list[int]:
        """Return the run's guardian; an empty list if there is none."""
        return [pid for pid in self.descendants() if b"guardian" in _command(pid)]

    def release_all(self) -> None:
        """Continue everything that was stopped."""
        for release in self.release:
            release()
        self.release.clear()

    def undo_all(self) -> None:
        """Make folders writable again."""
        for undo in self.undo:
            with contextlib.suppress(OSError, subprocess.SubprocessError):
                undo()
        self.undo.clear()

    def clear_up(self) -> None:
        """Remove leaked connections, immutable folders, helpers and remaining processes."""
        self.undo_all()
        for leak in self.leaks:
            leak.close()
        self.leaks.clear()
        for helper in self.helpers:
            helper.kill()
            helper.wait()
        self.helpers.clear()
        for pid in processes.marked(self.marker):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def _command(pid: int) -> bytes:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


@contextlib.asynccontextmanager
async def set_chaos_stage(
    needs: frozenset[str], watchdog: bool, generator: random.Random, place: Path
) -> AsyncIterator[ChaosStage]:
    """Start rig, wires and a run on it, all in `place`; `needs` as in `chaos_kinds`."""
    async with contextlib.AsyncExitStack() as stack:
        truth = place / "truth.bin"
        rig = await start_virtual_rig(
            seed=generator.randrange(2**31), mode="real", period_s=PERIOD_S, effects=None, truth=truth
        )
        await stack.enter_async_context(rig)
        device = LyingDevice(rig.modbus_port) if "device" in needs else None
        if device is not None:
            await stack.enter_async_context(device)
        plc = FaultyLink(rig.modbus_port if device is None else device.port, modbus_frames)
        can = FaultyLink(rig.can_port, can_frames)
        await stack.enter_async_context(plc)
        await stack.enter_async_context(can)
        await prepare(rig.modbus_port)
        while (now := last_moment(truth)) is None or now.fan_pct < FANS_PCT:  # noqa: ASYNC110
            await asyncio.sleep(LOOK_EVERY_S)
        text = chaos_rig_text({"plc": plc.port, "thermocouples": can.port}, watchdog=watchdog)
        (place / "rig.toml").write_text(text, encoding="utf-8")
        (place / "load.csv").write_text(LOAD.format(generator.randrange(300, 600)), encoding="utf-8")
        disk = await asyncio.to_thread(OwnDisk, place / "disk") if "tmpfs" in needs else None
        if disk is not None:
            stack.callback(disk.close)
        clock = await asyncio.to_thread(SteppedClock, place) if "clock" in needs else None
        terminal = Terminal(place, "pipe" if "pipe" in needs else "pty" if "pty" in needs else "files")
        stack.callback(terminal.close)
        marker = uuid.uuid4().hex
        harness = await _start(needs, place, disk, terminal, clock, marker)
        stack.push_async_callback(harness.finish)
        stage = ChaosStage(
            generator,
            rig,
            plc,
            can,
            harness,
            truth,
            disk,
            terminal=terminal,
            device=device,
            clock=clock,
            marker=marker,
        )
        stack.callback(stage.clear_up)
        yield stage


def chaos_rig_text(ports: dict[str, int], *, watchdog: bool) -> str:
    """Return the rig file; without `watchdog` the rig's own waits longer than any case."""
    text = rig_text(ports)
    seconds = WATCHDOG_S if watchdog else WATCHDOG_OFF_S
    text = _replaced(r"(?m)^watchdog_s = .*$", f"watchdog_s = {seconds}", text)
    return _replaced(r"(?m)^readback_within_s = .*$", f"readback_within_s = {READBACK_WITHIN_S}", text)


def _replaced(pattern: str, by: str, text: str) -> str:
    changed, count = re.subn(pattern, by, text)
    if not count:
        raise ValueError(f"the rig file of the campaign has no line {pattern}")
    return changed


async def _start(
    needs: frozenset[str],
    place: Path,
    disk: OwnDisk | None,
    terminal: Terminal,
    clock: SteppedClock | None,
    marker: str,
) -> ChaosHarness:
    command = [sys.executable, "-m", "hil", "run", str(place / "load.csv"), "--rig", str(place / "rig.toml")]
    command += ["--calibrator", "least_squares"] if "twin" in needs else ["--no-twin"]
    command += ["--no-viewer", "--runs", str((disk.inside if disk is not None else place) / "runs")]
    where = place
    if disk is not None:
        command, where = disk.command(command), disk.path
    process = await asyncio.create_subprocess_exec(
        *command,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=terminal.out,
        stderr=terminal.err,
        cwd=place,
        env=environment(marker, clock, is_terminal=terminal.shape == "pty"),
        start_new_session=True,
    )
    terminal.started()
    return ChaosHarness(where, place, process)


def environment(marker: str, clock: SteppedClock | None = None, *, is_terminal: bool = False) -> dict[str, str]:
    """Return the environment of a run of a case."""
    variables = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", processes.MARKER: marker}
    variables["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        variables.pop(name, None)
    if is_terminal:
        variables["TERM"] = "xterm-256color"
    return variables | ({} if clock is None else clock.environment)


def unstepped(wall_s: float, stage: ChaosStage) -> float:
    """Convert a wall time of the run's stepped clock to this machine's clock; steps are longer than any case."""
    if stage.clock is None or not stage.clock.offset_s:
        return wall_s
    plain, now = wall_s - stage.clock.offset_s, time.time()
    return min((wall_s, plain), key=lambda t: abs(t - now))
