"""Stage of a case of the fault campaign: its virtual rig, wires that can fail, `hil run` in a process."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import random
import signal
import sys
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path

from drivers.virtual import VirtualRig, start_virtual_rig
from drivers.virtual.devices import Moment, last_moment, read_truth
from drivers.virtual.faults import FaultyLink, as_it_comes, can_frames, modbus_frames
from drivers.virtual.plant import CHANNELS
from hil.bench.faults import judge
from hil.bench.faults.disk import OwnDisk
from hil.bench.faults.kinds import effect_text
from hil.bench.faults.plan import FaultCase
from hil.bench.faults.rig import LOAD, PERIOD_S, prepare, rig_text
from hil.bench.faults.tls import Certificates, make_certificates
from hil.bench.measure import processes

ROOT = Path(__file__).resolve().parents[3]
LOOK_EVERY_S = 0.2
SPIN_UP_S = 30.0
"""Time in s in which every fan reaches its speed."""
FANS_PCT = 70.0
"""Fan speed at the start of the command from which fans reach full speed before the run has a rig, %."""


class Harness:
    """Process `hil run` as a user starts it, with its output in files."""

    def __init__(self, place: Path, terminal: Path, process: asyncio.subprocess.Process) -> None:
        self.place, self.terminal, self.process = place, terminal, process
        self.started_s = time.time()

    @property
    def running(self) -> bool:
        """Return True while the process exists."""
        return self.process.returncode is None

    @property
    def pid(self) -> int:
        """Return the id of the process."""
        return self.process.pid

    def folder(self) -> Path | None:
        """Return the run's folder, or None before it exists."""
        return next(iter(sorted(self.place.glob("runs/*-load"))), None)

    @property
    def journal(self) -> Path:
        """Return the path of the run's journal; before it exists, a path without a file."""
        return (self.folder() or self.place) / "journal.sqlite"

    def said(self) -> str:
        """Return the output in its terminal."""
        return (self.terminal / "err.txt").read_text(encoding="utf-8", errors="replace")

    def ended_as(self) -> str:
        """Return the exit status that the run recorded, "" while it goes on."""
        folder = self.folder()
        try:
            status = json.loads(((folder or self.place) / "run.json").read_text(encoding="utf-8"))["exit_status"]
        except (OSError, ValueError, KeyError):
            return ""
        return "" if status == "running" else str(status)

    async def finish(self) -> None:
        """Kill the remaining processes."""
        if self.running:
            with contextlib.suppress(ProcessLookupError):
                self.process.kill()
        await self.process.wait()


@dataclass(slots=True)
class Stage:
    """Targets of a case's fault; see `hil.bench.faults.kinds`."""

    generator: random.Random
    rig: VirtualRig
    plc: FaultyLink
    can: FaultyLink
    harness: Harness
    truth: Path
    disk: OwnDisk | None = None
    asked_s: float = math.inf
    waited_s: float = math.inf
    starved_s: float = 0.0
    """Wait of the harness for a processor at the fault, s; the longest since then, or the longest stall of our own
    relays.
    """
    told_s: float | None = None
    """Time at which the harness reported its end on its terminal."""
    seen: judge.AcknowledgedSamples = field(default_factory=judge.AcknowledgedSamples)

    @property
    def pid(self) -> int:
        """Return the process of the harness."""
        return self.harness.pid

    async def reboot(self, seconds: float) -> None:
        """Power-cycle the PLC."""
        reader, writer = await asyncio.open_connection(self.rig.host, self.rig.control_port)
        await reader.readline()
        writer.write(f"reboot {seconds:g}\n".encode())
        answer = await reader.readline()
        writer.close()
        if answer != b"ok\n":
            raise RuntimeError(f"the virtual rig did not reboot: {answer!r}")

    def fill_disk(self) -> None:
        """Fill the harness's disk."""
        assert self.disk is not None
        self.disk.fill(self.pid)

    async def mend(self, rig_s: float) -> None:
        """End every fault there was: wires, disk, and those of the rig's own, which are over at `rig_s` of its time.

        A fan that was mended is so when it turns again: as before the first start, see `FANS_PCT`.
        """
        await self.plc.restore()
        await self.can.restore()
        if self.disk is not None:
            self.disk.clear()

        def mended() -> bool:
            now = last_moment(self.truth)
            return now is not None and now.rig_s >= rig_s and now.fan_pct >= FANS_PCT

        await self.until(mended, rig_s + SPIN_UP_S)

    def seen_here(self, folder: Path) -> Path:
        """Return a folder of the run as its process sees it."""
        return folder if self.disk is None else self.disk.inside / folder.relative_to(self.disk.path)

    def kill_child(self, words: str) -> None:
        """Send SIGKILL to the harness's children with `words` in their command."""
        found = [pid for pid in processes.children(self.pid) if words.encode() in processes.command(pid)]
        if not found:
            raise RuntimeError(f"the harness has no process of {words}")
        for pid in found:
            os.kill(pid, signal.SIGKILL)

    def look(self) -> Path:
        """Read newly acknowledged samples; return a path at which the journal can be opened."""
        journal = self.harness.journal
        if self.disk is not None and self.disk.real:
            journal = self.disk.copied(journal, self.truth.parent / "journal")
        self.seen.look(journal)
        return journal

    def moments(self) -> list[Moment]:
        """Return the true states so far."""
        return read_truth(self.truth)

    @property
    def heater_W(self) -> float:
        """Return the present power of the heater."""
        now = last_moment(self.truth)
        return 0.0 if now is None else now.heater_W

    async def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait for `condition`, and read the journal meanwhile; return True if it came true in time."""
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.look()
            self.starved_s = max(self.starved_s, processes.waited_s(self.pid) - self.waited_s)
            if self.told_s is None and " finishing: " in self.harness.said():
                self.told_s = time.time()
            asleep = time.monotonic()
            await asyncio.sleep(LOOK_EVERY_S / 2)
            if self.waited_s < math.inf:
                self.starved_s = max(self.starved_s, time.monotonic() - asleep - LOOK_EVERY_S / 2)
        return True


@contextlib.asynccontextmanager
async def set_stage(case: FaultCase, generator: random.Random, place: Path, onset_s: float) -> AsyncIterator[Stage]:
    """Start rig, wires and a run in `place`; a first fault of the rig itself begins at `onset_s` of its time."""
    async with contextlib.AsyncExitStack() as stack:
        stack.callback(_end_processes, place)
        # Long work goes to a thread: the relays of parallel cases must not wait for it.
        certificates: Certificates | None = None
        if "tls" in case.places:
            certificates = await asyncio.to_thread(make_certificates, place)
        effects = None
        begins = zip(case.kinds, (onset_s, onset_s + case.apart_s), strict=False)
        texts = [effect_text(kind, generator, CHANNELS, at_s) for kind, at_s in begins if kind.effect]
        if texts:
            effects = place / "effects.toml"
            effects.write_text("\n".join(texts), encoding="utf-8")
        truth = place / "truth.bin"
        rig = await start_virtual_rig(
            seed=generator.randrange(2**31),
            mode="real",
            period_s=PERIOD_S,
            effects=effects,
            truth=truth,
            tls=None if certificates is None else certificates.rig,
        )
        await stack.enter_async_context(rig)
        plc = FaultyLink(rig.modbus_port, as_it_comes if certificates else modbus_frames)
        can = FaultyLink(rig.can_port, can_frames)
        await stack.enter_async_context(plc)
        await stack.enter_async_context(can)
        await prepare(rig.modbus_port, None if certificates is None else certificates.context())
        while (now := last_moment(truth)) is None or now.fan_pct < FANS_PCT:  # noqa: ASYNC110
            await asyncio.sleep(LOOK_EVERY_S)
        ports = {"plc": plc.port, "thermocouples": can.port}
        text = rig_text(ports, None if certificates is None else certificates.harness)
        (place / "rig.toml").write_text(text, encoding="utf-8")
        (place / "load.csv").write_text(LOAD.format(generator.randrange(300, 600)), encoding="utf-8")
        disk = await asyncio.to_thread(OwnDisk, place / "disk") if "tmpfs" in case.places else None
        if disk is not None:
            stack.callback(disk.close)
        harness = await _start(case, place, disk)
        stack.push_async_callback(harness.finish)
        yield Stage(generator, rig, plc, can, harness, truth, disk)


def _end_processes(place: Path) -> None:
    """End what the runs of `place` left behind: a guardian tries for an hour to reach a rig that is gone."""
    for pid in processes.marked(str(place)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


async def _start(case: FaultCase, place: Path, disk: OwnDisk | None) -> Harness:
    command = [sys.executable, "-m", "hil", "run", str(place / "load.csv"), "--rig", str(place / "rig.toml")]
    command += ["--calibrator", "least_squares"] if "twin" in case.places else ["--no-twin"]
    command += ["--viewer"] if "viewer" in case.places else ["--no-viewer"]
    where = place
    if disk is not None:
        command, where = disk.command(command), disk.path
    command += ["--runs", str((disk.inside if disk is not None else place) / "runs")]
    return Harness(where, place, await spawn(command, place))


async def spawn(command: list[str], place: Path) -> asyncio.subprocess.Process:
    """Start a command of ours with two files as its terminal."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", processes.MARKER: str(place)}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(name, None)
    with (place / "out.txt").open("ab") as out, (place / "err.txt").open("ab") as err:
        return await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            cwd=place,
            env=environment,
            start_new_session=True,
        )


def last_line(place: Path) -> str:
    """Return the last line of the terminal in `place`; "" if there is none."""
    return next(iter((place / "err.txt").read_text(encoding="utf-8", errors="replace").splitlines()[-1:]), "")


def last_words(place: Path) -> str:
    """Return the last lines of the run's terminal, which is in `place`."""
    lines = [
        line
        for name in ("err.txt", "out.txt")
        if (place / name).is_file()
        for line in (place / name).read_text(encoding="utf-8", errors="replace").splitlines()[-4:]
    ]
    return " / ".join(lines)[-400:]
