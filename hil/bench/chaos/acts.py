"""Attacks of the chaos campaign on processes, terminal, files and limits of a run."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from functools import partial

from hil.bench.chaos.device import Mode, write_register
from hil.bench.chaos.stage import ChaosStage
from hil.bench.faults import ABORT_AFTER_S, PERIOD_S
from hil.bench.measure import processes

Act = Callable[[ChaosStage], Awaitable[None]]

BRIEF_S = (0.3, 0.7)
"""Pause in s that the run must survive: the guardian waits for a beat for 1 s, and beats are 0.2 s apart."""
LONG_S = (1.5, 6.0)
"""Pause in s that ends the run: well over the 1 s that the guardian waits for a beat."""
ALL_LONG_S = (ABORT_AFTER_S + 3.0 * PERIOD_S, 6.0)
"""Pause in s of all processes that ends the run: an interlock trips on `abort_after_s` and a period without a tick, and
ticks are counted in whole periods."""
LOCK_S = (1.0, 10.0)
CLOCK_STEPS_S = (600, 3600, 86_400, 315_360_000)
"""Steps of the clock, s: longer than a case, so that times before and after a step are distinguishable."""
MEMORY_MB = (2, 12)
FOREIGN_EVERY_S = 0.05
"""Interval between writes of another master, s: twice in a tick, so that its value is present at every read-back of
set-points.
"""
FOREIGN_ONCE_S = (0.0, 0.15)
FOREIGN_ON_S = (1.5, 3.0)
"""Duration of repeated writes of another master, s; set-points are read back once a second
(`hil.run.outputs.readback`).
"""
_LOCK = """
import sqlite3, sys, time
database = sqlite3.connect(sys.argv[1], isolation_level=None, timeout=5)
database.execute("BEGIN IMMEDIATE")
print("locked", flush=True)
time.sleep(float(sys.argv[2]))
database.execute("ROLLBACK")
"""


class NotPossibleError(RuntimeError):
    """Error of an attack that the machine does not allow; the message states the reason."""


def _send(pid: int, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def sent(number: signal.Signals) -> Act:
    """Return the act that sends a signal to the harness."""

    async def act(stage: ChaosStage) -> None:
        _send(stage.pid, number)

    return act


def guardian_sent(*numbers: signal.Signals) -> Act:
    """Return the act that sends signals to the guardian; raise RuntimeError if there is none."""

    async def act(stage: ChaosStage) -> None:
        found = stage.guardians()
        if not found:
            raise RuntimeError("the run has no guardian")
        for pid in found:
            for number in numbers:
                _send(pid, number)

    return act


def paused(seconds: tuple[float, float], *, everything: bool = False) -> Act:
    """Return the act that stops the harness, or `everything` that it started too, and continues it later."""

    async def act(stage: ChaosStage) -> None:
        length_s = stage.generator.uniform(*seconds)
        pids = [stage.pid, *(stage.descendants() if everything else ())]
        began = time.time()
        for pid in pids:
            _send(pid, signal.SIGSTOP)
        await asyncio.sleep(length_s)
        for pid in reversed(pids):
            _send(pid, signal.SIGCONT)
        if everything:
            stage.nobody.append((began, time.time()))

    return act


async def all_killed(stage: ChaosStage) -> None:
    """Kill harness and guardian at the same instant."""
    for pid in [*stage.descendants(), stage.pid]:
        _send(pid, signal.SIGSTOP)
    for pid in [*stage.descendants(), stage.pid]:
        _send(pid, signal.SIGKILL)


def calibrator_sent(number: signal.Signals) -> Act:
    """Return the act that sends a signal to the process of the calibrators."""

    async def act(stage: ChaosStage) -> None:
        found = [pid for pid in processes.children(stage.pid) if b"multiprocessing.spawn" in processes.command(pid)]
        if not found:
            raise RuntimeError("the run has no process of calibrators")
        for pid in found:
            _send(pid, number)
            stage.release.append(partial(_send, pid, signal.SIGCONT))

    return act


async def clock_stepped(stage: ChaosStage) -> None:
    """Step the wall clock of the run forward or back."""
    assert stage.clock is not None
    stage.stepped_s = time.time()
    stage.clock.step(stage.generator.choice((-1, 1)) * stage.generator.choice(CLOCK_STEPS_S))


async def reader_gone(stage: ChaosStage) -> None:
    """End the reader of the run's output."""
    assert stage.terminal is not None
    stage.terminal.hang_up()


async def reader_stops(stage: ChaosStage) -> None:
    """Stop the reader of the run's output."""
    assert stage.terminal is not None
    stage.terminal.stop_reading()


async def ctrl_s(stage: ChaosStage) -> None:
    """Stop the terminal's output."""
    assert stage.terminal is not None
    stage.terminal.press_ctrl_s()


async def terminal_lost(stage: ChaosStage) -> None:
    """Lose the terminal like a dropped ssh session: it is gone, and SIGHUP comes."""
    assert stage.terminal is not None
    stage.terminal.hang_up()
    _send(stage.pid, signal.SIGHUP)


async def journal_locked(stage: ChaosStage) -> None:
    """Hold the write lock on the journal from another process."""
    seconds = stage.generator.uniform(*LOCK_S)
    helper = subprocess.Popen(  # noqa: ASYNC220 - it returns at once
        [sys.executable, "-c", _LOCK, str(stage.folder() / "journal.sqlite"), f"{seconds:.2f}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    stage.helpers.append(helper)
    assert helper.stdout is not None
    said = await asyncio.to_thread(helper.stdout.readline)
    helper.stdout.close()
    if said != b"locked\n":
        raise RuntimeError("the journal could not be locked")


async def folder_deleted(stage: ChaosStage) -> None:
    """Delete the run's folder."""
    stage.look()
    stage.destroyed = True
    for _ in range(3):  # A file that the run makes meanwhile leaves the folder behind.
        shutil.rmtree(stage.folder(), ignore_errors=True)


async def folder_renamed(stage: ChaosStage) -> None:
    """Rename the run's folder."""
    folder = stage.folder()
    moved = folder.with_name("moved_away")
    folder.rename(moved)
    assert hasattr(stage.harness, "known")
    stage.harness.known = moved


async def folder_read_only(stage: ChaosStage) -> None:
    """Prevent all changes in the run's folder, even by root."""
    folder = stage.folder()
    if os.geteuid() != 0:
        mode = folder.stat().st_mode
        folder.chmod(0o500)
        stage.undo.append(lambda: folder.chmod(mode))
        return
    if shutil.which("chattr") is None:
        raise NotPossibleError("root ignores modes, and there is no chattr")
    done = await asyncio.to_thread(subprocess.run, ["chattr", "+i", str(folder)], capture_output=True, check=False)
    if done.returncode != 0:
        raise NotPossibleError("this file system has no immutable folders")

    def undo() -> None:
        subprocess.run(["chattr", "-i", str(folder)], capture_output=True, check=True)

    stage.undo.append(undo)


def deleted(*patterns: str, samples: bool = False) -> Act:
    """Return the act that deletes files of the run's folder; `samples` if the journal is among them."""

    async def act(stage: ChaosStage) -> None:
        stage.look()
        stage.destroyed |= samples
        for pattern in patterns:
            for path in stage.folder().glob(pattern):
                path.unlink(missing_ok=True)

    return act


async def disk_full(stage: ChaosStage) -> None:
    """Fill the run's disk."""
    stage.fill_disk()


async def link_blip(stage: ChaosStage) -> None:
    """Reset the Modbus connection; the port is back after 0.05 to 0.3 s."""
    stage.plc.drop()
    await asyncio.sleep(stage.generator.uniform(0.05, 0.3))
    await stage.plc.restore()


async def descriptors_gone(stage: ChaosStage) -> None:
    """Use up all descriptors of the harness, then drop its link briefly."""
    limit = stage.generator.choice((3, max(processes.descriptors(stage.pid), default=2) + 1))
    _limit(stage.pid, resource.RLIMIT_NOFILE, limit)
    await link_blip(stage)


async def memory_gone(stage: ChaosStage) -> None:
    """Limit the harness to a few MB of address space."""
    limit = processes.address_space_bytes(stage.pid) + (stage.generator.randint(*MEMORY_MB) << 20)
    _limit(stage.pid, resource.RLIMIT_AS, limit)


def _limit(pid: int, what: int, value: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        resource.prlimit(pid, what, (value, resource.prlimit(pid, what)[1]))


def device_is(mode: Mode) -> Act:
    """Return the act that makes the device disobey from now on."""

    async def act(stage: ChaosStage) -> None:
        assert stage.device is not None
        stage.device.mode = mode

    return act


def second_master(register: int, value: int, for_s: tuple[float, float], *, heats: bool = False) -> Act:
    """Return the act of another master that writes a set-point, once and then every `FOREIGN_EVERY_S` for this time.

    `heats`: it switches the heater on.
    """

    async def act(stage: ChaosStage) -> None:
        until = time.monotonic() + stage.generator.uniform(*for_s)
        while True:
            await write_register(stage.rig.modbus_port, register, value)
            if heats:
                stage.foreign_s = time.time()
            if time.monotonic() >= until:
                return
            await asyncio.sleep(FOREIGN_EVERY_S)

    return act
