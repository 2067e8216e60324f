"""One case of the fault campaign: a virtual rig of its own, wires that can fail, `hil run` in a process, one fault."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from drivers.virtual.faulty_link import FaultyLink, as_it_comes, can_frames, modbus_frames
from drivers.virtual.geometry import CHANNELS
from drivers.virtual.rig import VirtualRig, start_virtual_rig
from drivers.virtual.truth import Moment, read_truth
from hil.bench import faults_judge as judge
from hil.bench.faults_disk import OwnDisk
from hil.bench.faults_kinds import KINDS, Kind, effect_text
from hil.bench.faults_rig import LOAD, PERIOD_S, STALE_LIMIT_S, WATCHDOG_S, prepare, rig_text
from hil.bench.faults_tls import Certificates, make_certificates

ROOT = Path(__file__).resolve().parents[2]
START_S = 40.0
END_S = 30.0
RESUME_S = 150.0
"""A run that goes on first stands still within its band for a minute."""
LOOK_EVERY_S = 0.2
FANS_PCT = 70.0
"""Fans that are this fast when the command is started are at full speed when it has a rig."""
EARLY_S = (1.0, 8.0)
"""A fault that may come at any instant strikes this long after the command was started, s."""
EARLIEST_S, LATEST_S = 0.5, 2.5
"""A fault strikes this long after the heater went on, s."""
AFTER_S = 1.5
"""A wire stays broken for this long after the heater is off, unless the run ends before."""
REACT_S = 1.0
"""From detection to safe."""
TRUTH_STEP_S = 2.0 * PERIOD_S
"""The watchdog looks once a period, and its last heartbeat may be younger than the fault."""


@dataclass(slots=True)
class Result:
    """What one case came to. Times in s after the occurrence; `detected` and `safe` are None where that never was.

    `by` is who detected: the harness or the rig's watchdog. `acknowledged` and `lost` count samples.
    """

    kind: str
    number: int
    ended: str = ""
    by: str = ""
    noticed: float | None = None
    detected: float | None = None
    safe: float | None = None
    heated: bool = False
    acknowledged: int = 0
    lost: int = 0
    unsaved_s: float | None = None
    wrong: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    reason: str = ""
    stall_s: float = 0.0
    attempts: int = 1
    resumed: bool | None = None
    struck: bool = True
    """Whether the fault came while something heated, where it had to."""


class Harness:
    """`hil run` as a user starts it, in a process of its own whose output goes to files."""

    def __init__(self, place: Path, terminal: Path, process: asyncio.subprocess.Process) -> None:
        self.place, self.terminal, self.process = place, terminal, process
        self.started_s = time.time()

    @property
    def running(self) -> bool:
        """Whether the process is there."""
        return self.process.returncode is None

    @property
    def pid(self) -> int:
        """Id of the process."""
        return self.process.pid

    def folder(self) -> Path | None:
        """The run's folder, once there is one."""
        return next(iter(sorted(self.place.glob("runs/*-load"))), None)

    @property
    def journal(self) -> Path:
        """The run's journal; a path that is not there while there is none."""
        return (self.folder() or self.place) / "journal.sqlite"

    def said(self) -> str:
        """What it has written to its terminal."""
        return (self.terminal / "err.txt").read_text(encoding="utf-8", errors="replace")

    def ended_as(self) -> str:
        """Exit status that the run wrote of itself, empty while it goes on."""
        folder = self.folder()
        try:
            status = json.loads(((folder or self.place) / "run.json").read_text(encoding="utf-8"))["exit_status"]
        except (OSError, ValueError, KeyError):
            return ""
        return "" if status == "running" else str(status)

    async def finish(self) -> None:
        """Kill what is left of it."""
        if self.running:
            with contextlib.suppress(ProcessLookupError):
                self.process.kill()
        await self.process.wait()


@dataclass(slots=True)
class Stage:
    """What the fault of a case may lay hands on; see `hil.bench.faults_kinds`."""

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
    """How long the harness had waited for a processor when the fault came; the longest that it has since, or that our
    own relays have stood still."""
    told_s: float | None = None
    """When the harness said on its terminal that it ends."""
    seen: judge.Seen = field(default_factory=judge.Seen)

    @property
    def pid(self) -> int:
        """Process of the harness."""
        return self.harness.pid

    async def reboot(self, seconds: float) -> None:
        """Power-cut of the PLC."""
        reader, writer = await asyncio.open_connection(self.rig.host, self.rig.control_port)
        await reader.readline()
        writer.write(f"reboot {seconds:g}\n".encode())
        answer = await reader.readline()
        writer.close()
        if answer != b"ok\n":
            raise RuntimeError(f"the virtual rig did not reboot: {answer!r}")

    def fill_disk(self) -> None:
        """No byte more for the harness."""
        assert self.disk is not None
        self.disk.fill(self.pid)

    def kill_child(self, words: str) -> None:
        """SIGKILL to the harness's children with `words` in their command."""
        found = [pid for pid in _children(self.pid) if words.encode() in _command(pid)]
        if not found:
            raise RuntimeError(f"the harness has no process of {words}")
        for pid in found:
            os.kill(pid, signal.SIGKILL)

    def look(self) -> Path:
        """See what the run has acknowledged; returns a path by which its journal can be opened."""
        journal = self.harness.journal
        if self.disk is not None and self.disk.real:
            journal = self.disk.copied(journal, self.truth.parent / "journal")
        self.seen.look(journal)
        return journal

    def moments(self) -> list[Moment]:
        """What was true so far."""
        return read_truth(self.truth)

    @property
    def heater_W(self) -> float:
        """What reaches the heater now."""
        moments = self.moments()
        return moments[-1].heater_W if moments else 0.0

    async def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Wait for `condition`, looking into the journal meanwhile; whether it came true in time."""
        deadline = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.look()
            self.starved_s = max(self.starved_s, _waited_s(self.pid) - self.waited_s)
            if self.told_s is None and " finishing: " in self.harness.said():
                self.told_s = time.time()
            asleep = time.monotonic()
            await asyncio.sleep(LOOK_EVERY_S / 2)
            if self.waited_s < math.inf:
                self.starved_s = max(self.starved_s, time.monotonic() - asleep - LOOK_EVERY_S / 2)
        return True


async def run_case(
    kind_name: str, number: int, seed: int, *, thorough: bool = False, resume: bool = True, retries: int = 2
) -> Result:
    """One case. It is repeated where the fault came before the run, and where the machine stood still and a must was
    broken. `thorough` waits for record and report, `resume` resumes what was killed."""
    for attempt in range(1, retries + 2):
        generator = random.Random(f"{seed} {kind_name} {number}")
        with tempfile.TemporaryDirectory(prefix="hil-fault-") as folder:
            try:
                result = await _attempt(kind_name, number, generator, Path(folder), thorough, resume, attempt)
            except Exception as error:  # a case that cannot be carried out is no reason to leave out the others
                result = Result(kind_name, number, failures=[f"not carried out: {type(error).__name__}: {error}"])
        result.attempts = attempt
        if result.struck and (not result.failures or result.stall_s < STALL_S):
            break
    return result


STALL_S = 0.4
"""A machine on which rig, harness or relays waited this long for a processor while it mattered cannot keep a limit of a
second. Of the rig its own log tells, of the harness the kernel (/proc/PID/schedstat), of the relays our own clock."""


async def _attempt(
    name: str, number: int, generator: random.Random, place: Path, thorough: bool, resume: bool, attempt: int
) -> Result:
    kind, result = KINDS[name], Result(name, number)
    onset_s = generator.uniform(9.0, 12.0) + 8.0 * (attempt - 1)
    async with _stage(kind, generator, place, onset_s) as stage:
        occurred_s = await _strike(stage, kind, onset_s, result)
        if occurred_s is None:
            return result
        await _follow(stage, kind, occurred_s, result, thorough)
        journal = await asyncio.to_thread(_judged, result, kind, stage, occurred_s)
        if resume and name == "SIGKILL" and result.heated and journal.ticks and not result.failures:
            result.resumed = await _resumed(stage, result)
        if result.failures:
            result.reason = (result.reason + " | " + _last_words(place))[:600]
    return result


@contextlib.asynccontextmanager
async def _stage(kind: Kind, generator: random.Random, place: Path, onset_s: float) -> AsyncIterator[Stage]:
    async with contextlib.AsyncExitStack() as stack:
        # What takes long goes to a thread: the relays of the cases beside this one must not stand still for it.
        certificates: Certificates | None = None
        if kind.place == "tls":
            certificates = await asyncio.to_thread(make_certificates, place)
        effects = None
        if kind.effect:
            effects = place / "effects.toml"
            effects.write_text(effect_text(kind, generator, CHANNELS, onset_s), encoding="utf-8")
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
        await prepare(rig.modbus_port, WATCHDOG_S, None if certificates is None else certificates.context())
        while not (moments := read_truth(truth)) or moments[-1].fan_pct < FANS_PCT:  # noqa: ASYNC110
            await asyncio.sleep(LOOK_EVERY_S)
        ports = {"plc": plc.port, "thermocouples": can.port}
        text = rig_text(ports, None if certificates is None else certificates.harness)
        (place / "rig.toml").write_text(text, encoding="utf-8")
        (place / "load.csv").write_text(LOAD.format(generator.randrange(300, 600)), encoding="utf-8")
        disk = await asyncio.to_thread(OwnDisk, place / "disk") if kind.place == "tmpfs" else None
        if disk is not None:
            stack.callback(disk.close)
        harness = await _start(kind, place, disk)
        stack.push_async_callback(harness.finish)
        yield Stage(generator, rig, plc, can, harness, truth, disk)


async def _start(kind: Kind, place: Path, disk: OwnDisk | None) -> Harness:
    command = [sys.executable, "-m", "hil", "run", str(place / "load.csv"), "--rig", str(place / "rig.toml")]
    command += ["--calibrator", "least_squares"] if kind.place == "twin" else ["--no-twin"]
    command += ["--viewer"] if kind.place == "viewer" else ["--no-viewer"]
    where = place
    if disk is not None:
        command, where = disk.command(command), disk.path
    command += ["--runs", str((disk.inside if disk is not None else place) / "runs")]
    return Harness(where, place, await _spawn(command, place))


async def _spawn(command: list[str], place: Path) -> asyncio.subprocess.Process:
    """A command of ours with a terminal that is two files."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(name, None)
    with (place / "out.txt").open("ab") as out, (place / "err.txt").open("ab") as err:
        return await asyncio.create_subprocess_exec(
            *command, stdin=asyncio.subprocess.DEVNULL, stdout=out, stderr=err, cwd=place, env=environment,
            start_new_session=True,
        )  # fmt: skip


async def _strike(stage: Stage, kind: Kind, onset_s: float, result: Result) -> float | None:
    """Let the fault occur; its wall time, or None where there was no run to strike."""
    if kind.early:
        await stage.until(lambda: not stage.harness.running, stage.generator.uniform(*EARLY_S))
    elif not await stage.until(lambda: stage.heater_W > 100.0 or not stage.harness.running, START_S):
        result.failures.append("the run did not start within its time")
        return None
    if not stage.harness.running and not kind.early:
        result.struck = False
        result.failures.append(f"the run ended before the fault: {_last_words(stage.truth.parent)}")
        return None
    stage.waited_s = _waited_s(stage.pid)
    if kind.act is None:
        if not await stage.until(lambda: _after(stage, onset_s) is not None, START_S):
            result.failures.append("the rig stood still")
            return None
        return _after(stage, onset_s)
    if not kind.early:
        await stage.until(lambda: False, stage.generator.uniform(EARLIEST_S, LATEST_S))
        stage.look()
    occurred_s = time.time()
    await kind.act(stage)
    return occurred_s


def _after(stage: Stage, rig_s: float) -> float | None:
    return next((moment.wall_s for moment in stage.moments() if moment.rig_s >= rig_s - 1e-6), None)


async def _follow(stage: Stage, kind: Kind, occurred_s: float, result: Result, thorough: bool) -> None:
    """Until the heater is off and the run has ended; a run that goes on is ended by SIGTERM."""
    harness, began = stage.harness, time.monotonic()

    def over() -> bool:
        if kind.ending == "killed":
            return stage.heater_W == 0.0
        return not harness.running or harness.ended_as() != ""

    if kind.ending in ("rides", "either"):
        # Long enough for any limit to run out on a fault that lasts as long as these.
        await stage.until(over, STALE_LIMIT_S + (4.0 if kind.ending == "either" else 0.0))
        if harness.running and harness.ended_as() == "":
            result.ended = "rode through"
            if stage.heater_W <= 0.0:
                result.failures.append("the run goes on and nothing heats")
            stage.asked_s = time.time()
            os.kill(stage.pid, signal.SIGTERM)
            await _ended(stage, result)
            await _leave(stage, thorough, result)
            return
    # A wire that is in order again lets a run end that could not reach its rig; nothing may heat because of it.
    if await stage.until(lambda: over() or stage.heater_W == 0.0, STALE_LIMIT_S + END_S) and harness.running:
        await stage.until(over, AFTER_S)
        await stage.plc.restore()
        await stage.can.restore()
    if not await stage.until(over, END_S):
        result.failures.append(f"the run has not ended {time.monotonic() - began:.0f} s after the fault")
    if kind.ending == "killed":
        await stage.until(lambda: False, 0.3)
        result.ended = "killed"
    await _leave(stage, thorough and kind.ending != "killed", result)


async def _ended(stage: Stage, result: Result) -> None:
    harness, asked_s = stage.harness, stage.asked_s
    if not await stage.until(lambda: not harness.running or harness.ended_as() != "", END_S):
        result.failures.append(f"the run did not end within {END_S:g} s of SIGTERM")
        return
    safe = judge.safe_since(stage.moments(), asked_s)
    if safe is None or safe - asked_s > REACT_S:
        after = "never" if safe is None else f"{safe - asked_s:.2f} s"
        result.failures.append(f"the heater was off {after} after SIGTERM")


async def _resumed(stage: Stage, result: Result) -> bool:
    """`hil resume` on what the kill has left: whether the run went on, with everything that was acknowledged before."""
    folder = stage.harness.folder()
    assert folder is not None
    before, asked_s = dict(stage.seen.rows), time.time()
    command = [sys.executable, "-m", "hil", "resume", str(folder), "--no-viewer", "--band", "3"]
    stage.harness.process = await _spawn(command, stage.truth.parent)

    def running() -> bool:
        states = judge.read_states(stage.harness.journal)
        return any(wall_s > asked_s and target == "running" for wall_s, target in states)

    went_on = await stage.until(lambda: running() or not stage.harness.running, RESUME_S)
    went_on = went_on and stage.harness.running
    if not went_on:
        result.failures.append(f"not resumed within {RESUME_S:g} s")
    else:
        stage.asked_s = time.time()
        os.kill(stage.pid, signal.SIGTERM)
        await _ended(stage, result)
    await stage.harness.finish()
    journal = await asyncio.to_thread(lambda: judge.read_journal(stage.look()))
    gone = judge.lost(stage.seen, journal)
    if gone or not set(before) <= set(journal.ticks) or not journal.sound:
        result.failures.append(f"{gone} acknowledged samples lost by resuming")
    result.lost += gone
    result.wrong += await asyncio.to_thread(judge.wrong_values, journal, stage.moments())
    return went_on


async def _leave(stage: Stage, thorough: bool, result: Result) -> None:
    """Let the run write its record and report where that is looked at, else spare the machine that."""
    harness = stage.harness
    if thorough and harness.running and not await stage.until(lambda: not harness.running, 60.0):
        result.failures.append("record and report were not written within 60 s")
    await harness.finish()
    stage.look()


def _judged(result: Result, kind: Kind, stage: Stage, occurred_s: float) -> judge.Journal:
    """Fill in `result` from what rig and harness left; the journal."""
    truth, journal = stage.moments(), judge.read_journal(stage.look())
    _judge(result, kind, stage, journal, truth, occurred_s)
    return journal


def _judge(
    result: Result, kind: Kind, stage: Stage, journal: judge.Journal, truth: list[Moment], occurred_s: float
) -> None:
    harness = stage.harness
    before = [moment for moment in truth if moment.wall_s <= occurred_s]
    result.heated = bool(before) and before[-1].heater_W > 0.0
    result.stall_s = max(judge.longest_stall_s(truth, harness.started_s), stage.starved_s)
    result.acknowledged, result.lost = len(stage.seen.rows), judge.lost(stage.seen, journal)
    result.wrong = judge.wrong_values(journal, truth)
    noticed, left = judge.noticed_at(journal, occurred_s, stage.asked_s), judge.ended_at(journal, occurred_s)
    watchdog, safe = judge.watchdog_at(truth, occurred_s), judge.safe_since(truth, occurred_s)
    result.noticed = None if noticed is None else noticed - occurred_s
    rode = result.ended == "rode through"
    result.reason = next((row[3] for row in reversed(journal.states) if row[2] in ("finishing", "faulted")), "")
    if left is None and kind.place == "tmpfs":
        left = stage.told_s  # its journal cannot say so any more
    detected = noticed if rode else min((t for t in (left, watchdog) if t is not None), default=None)
    if not rode:
        result.by = "" if detected is None else "harness" if detected == left else "rig"
        result.ended = result.ended or harness.ended_as() or "ended by itself"
        result.safe = None if safe is None else safe - occurred_s
    if detected is not None:
        result.detected = detected - occurred_s
    if journal.ticks and kind.ending == "killed":
        result.unsaved_s = max(occurred_s - journal.wall_s[-1], 0.0)
    if "Traceback" in harness.said() and not kind.early:
        result.failures.append("it ended with a traceback instead of a sentence")
    result.failures += _broken(result, kind, journal, rode)


def _broken(result: Result, kind: Kind, journal: judge.Journal, rode: bool) -> list[str]:
    """Which of the musts this case broke."""
    broken = []
    if kind.ending == "rides" and not rode:
        broken.append("the run ended of a fault that it has to ride through")
    if kind.ending == "stops" and rode:
        broken.append("the run went on")
    if result.heated and not rode:
        limit = WATCHDOG_S + TRUTH_STEP_S if kind.ending == "killed" else STALE_LIMIT_S
        if result.safe is None:
            broken.append("the heater was never cut")
        elif result.safe > limit:
            broken.append(f"safe {result.safe:.2f} s after the fault, the limit is {limit:g} s")
        if result.detected is None:
            broken.append("never detected")
        elif result.safe is not None and result.safe - result.detected > REACT_S:
            broken.append(f"safe {result.safe - result.detected:.2f} s after detection")
    if not result.heated and not kind.early:
        result.struck = False
        broken.append("nothing heated when the fault came")
    if not result.heated and result.safe is None and not rode:
        broken.append("something heats after the fault")
    if not journal.sound:
        broken.append("the journal is damaged")
    if result.lost:
        broken.append(f"{result.lost} acknowledged samples lost")
    if result.wrong:
        broken.append(f"{len(result.wrong)} wrong values recorded as good: {result.wrong[0]}")
    if result.unsaved_s is not None and result.unsaved_s > 1.0:
        broken.append(f"the last {result.unsaved_s:.2f} s were not in the journal")
    return broken


def _last_words(place: Path) -> str:
    lines = [
        line for name in ("err.txt", "out.txt") if (place / name).is_file()
        for line in (place / name).read_text(encoding="utf-8", errors="replace").splitlines()[-4:]
    ]  # fmt: skip
    return " / ".join(lines)[-400:]


def _children(pid: int) -> list[int]:
    """Processes that any of its threads has started."""
    found: list[int] = []
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError):  # a thread that has just ended
                found += map(int, (task / "children").read_text().split())
    return found


def _waited_s(pid: int) -> float:
    """How long the main thread of a process was ready to run and did not, s; 0 where the kernel does not tell."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text().split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return 0.0


def _command(pid: int) -> bytes:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def as_document(result: Result) -> dict[str, Any]:
    """As JSON has it."""
    return asdict(result)
