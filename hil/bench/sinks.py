"""Cost of what follows a run: streams, alarms and panel beside a run at 10 Hz, viewers of a panel, exports of 40 hours.

One run goes on in real time. Segments with one follower take turns with segments without any, so that whatever else the
machine does falls on all of them. A follower costs the run the difference to the mean of the segments before and after.
Linux reports the processor time (`/proc`).
"""

from __future__ import annotations

import contextlib
import http.client
import re
import resource
import select
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.rig_file import load_rig
from hil.bench.measure import Cell, ReportTable, processes
from hil.journal import Header, JournalReader, JournalWriter
from hil.run_folder import RunFolder, new_manifest

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
RIG = PROFILES / "rigs" / "virtual.toml"
PERIOD_S = 0.1
GOAL_TICK, GOAL_EXPORT_S, GOAL_PANEL, VIEWERS = 1.0, 5.0, 10.0, 20
"""Goals: % of a tick's time for a follower, s for an export, % of a core for a panel with this many viewers."""
LADEN = "Other times depend on what else the machine does; the manifest has its load."
FORMATS = ("csv", "parquet", "mf4", "hdf5", "tdms")
HOURS = 40.0
STARTS_WITHIN_S = 60.0
SETTLES_S = 6.0
"""Time that a follower has to start and to take what the run has written before, s."""
COMMIT = 5_000
"""Ticks of a commit of the journal that is made for exports."""


@dataclass(frozen=True, slots=True)
class SinksSize:
    """Size of the benchmark: rounds of all followers, s of a segment, and length of the exported run, h."""

    rounds: int
    segment_s: float
    hours: float


FULL = SinksSize(rounds=3, segment_s=10.0, hours=HOURS)
QUICK = SinksSize(rounds=1, segment_s=3.0, hours=2.0)


@dataclass(frozen=True, slots=True)
class _Segment:
    """Segment of the run: processor time and median work of a tick, s, and processor time of the follower, s/s."""

    cpu_s: float
    work_s: float
    follower: float = 0.0


def measure(
    size: SinksSize, stores: Sequence[str], progress: Callable[[float, str], None]
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Measure all of it.

    Parameters
    ----------
    size
        How much.
    stores
        Addresses of stores, as `hil stream --to` takes them.
    progress
        Called with the share done and the stage.

    Returns
    -------
    tables, left out
        Tables, and a line for each format that cannot be written here.

    Raises
    ------
    RuntimeError
        A process did not start, or ended; the message repeats its last line.
    """
    with tempfile.TemporaryDirectory(prefix="hil-bench-sinks-") as name:
        folder = Path(name)
        with _run(folder) as (run, path):
            followers = _followers(path, stores)
            segments = _segments(size, run, path, followers, lambda done, note: progress(0.6 * done, note))
            progress(0.6, f"{VIEWERS} viewers")
            viewed = [_viewed(size, path, count) for count in (0, 1, VIEWERS)]
        progress(0.8, f"exports of {size.hours:g} h")
        rows, skipped = _exports(_long_run(folder, size.hours), folder)
    return (_followers_table(segments, size), _viewers_table(viewed), _exports_table(rows, size)), skipped


@contextlib.contextmanager
def _run(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Start a run at 10 Hz on a virtual rig; yield its process and folder once it heats."""
    rig = RIG.read_text(encoding="utf-8").replace("period_s = 1.0", f"period_s = {PERIOD_S}")
    rig = rig.replace('"../twins/', f'"{PROFILES}/twins/').replace(
        '"thermocouples.dbc', f'"{RIG.parent}/thermocouples.dbc'
    )
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    load = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,500,90,70\n86400,500,90,70\n"
    (folder / "load.csv").write_text(load, encoding="utf-8")
    words = ["run", folder / "load.csv", "--rig", folder / "rig.toml", "--virtual", "--no-viewer"]
    with _started(folder, *words, "--calibrator", "least_squares", "--runs", folder / "runs") as process:
        deadline = time.monotonic() + STARTS_WITHIN_S
        while not (found := [path for path in (folder / "runs").glob("*/journal.sqlite") if _ticks(path) > 20]):
            _require(process, folder, deadline)
            time.sleep(0.2)
        yield process, found[0].parent


def _ticks(journal: Path) -> int:
    try:
        reader = JournalReader(journal)
    except Exception:  # it has just been made
        return 0
    try:
        return reader.last()[0]
    finally:
        reader.close()


@contextlib.contextmanager
def _started(folder: Path, *words: object) -> Iterator[subprocess.Popen[bytes]]:
    """Start a command of hil, with its output in `said` of the folder; end it in order."""
    with (folder / "said").open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "hil", *map(str, words)],
            cwd=PROFILES.parent,
            stdout=said,
            stderr=said,
            stdin=subprocess.DEVNULL,
        )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(STARTS_WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _require(process: subprocess.Popen[bytes], folder: Path, deadline: float = float("inf")) -> None:
    """Raise RuntimeError if a process has ended, or the time is over."""
    if process.poll() is not None or time.monotonic() > deadline:
        lines = (folder / "said").read_text(encoding="utf-8", errors="replace").strip().splitlines() or ["nothing"]
        raise RuntimeError(f"a command of the benchmark does not go on; it said: {lines[-1]}")


def _followers(path: Path, stores: Sequence[str]) -> dict[str, tuple[object, ...]]:
    """Return the commands that follow a run, by name."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    names = {"mqtt": "MQTT", "mqtts": "MQTT", "postgresql": "PostgreSQL", "postgres": "PostgreSQL"}
    found: dict[str, tuple[object, ...]] = {
        names.get(store.partition(":")[0], store.partition(":")[0]): ("stream", path, "--to", store) for store in stores
    }
    found["OPC UA"] = ("stream", path, "--to", f"opc.tcp://127.0.0.1:{port}/")
    found["alarms"] = ("alarms", path, "--follow")
    found["panel, one viewer"] = ("serve", path, "--port", 0)
    return found


def _segments(
    size: SinksSize,
    run: subprocess.Popen[bytes],
    path: Path,
    followers: dict[str, tuple[object, ...]],
    progress: Callable[[float, str], None],
) -> dict[str, list[tuple[_Segment, _Segment]]]:
    """Return for each follower its segments, each with the mean of the segments without one around it."""
    found: dict[str, list[tuple[_Segment, _Segment]]] = defaultdict(list)
    before = _segment(size, run, path, None)
    steps = size.rounds * len(followers)
    for number in range(steps):
        name, words = list(followers.items())[number % len(followers)]
        with _started(path.parent, *words) as follower, contextlib.ExitStack() as stack:
            viewers = stack.enter_context(_viewing(path, path.parent, int(words[0] == "serve")))
            _read(viewers, SETTLES_S)
            _require(follower, path.parent)
            during = _segment(size, run, path, follower, viewers)
        after = _segment(size, run, path, None)
        calm = _Segment((before.cpu_s + after.cpu_s) / 2, (before.work_s + after.work_s) / 2)
        found[name].append((during, calm))
        before = after
        progress((number + 1) / steps, name)
    return found


def _segment(
    size: SinksSize,
    run: subprocess.Popen[bytes],
    path: Path,
    follower: subprocess.Popen[bytes] | None,
    viewers: Sequence[socket.socket] = (),
) -> _Segment:
    others = [] if follower is None else [follower.pid]
    began, first, used = time.monotonic(), _ticks(path / "journal.sqlite"), processes.ran_s(run.pid)
    theirs = sum(map(processes.ran_s, others))
    _read(viewers, size.segment_s)
    theirs = sum(map(processes.ran_s, others)) - theirs
    used, last, took = processes.ran_s(run.pid) - used, _ticks(path / "journal.sqlite"), time.monotonic() - began
    reader = JournalReader(path / "journal.sqlite")
    try:
        work = reader.latencies()[first + 1 : last + 1]
    finally:
        reader.close()
    if not len(work):
        raise RuntimeError("the run of the benchmark has stopped")
    return _Segment(used * PERIOD_S / took, float(np.median(work)), theirs / took)


def _followers_table(segments: dict[str, list[tuple[_Segment, _Segment]]], size: SinksSize) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    share = 100.0 / PERIOD_S
    for name, pairs in segments.items():
        cpu = statistics.median(during.cpu_s - calm.cpu_s for during, calm in pairs)
        work = statistics.median(during.work_s - calm.work_s for during, calm in pairs)
        rows.append(
            (
                name,
                1e3 * statistics.median(calm.cpu_s for _, calm in pairs),
                1e3 * statistics.median(during.cpu_s for during, _ in pairs),
                share * cpu,
                1e3 * statistics.median(calm.work_s for _, calm in pairs),
                1e3 * statistics.median(during.work_s for during, _ in pairs),
                share * work,
                100.0 * statistics.median(during.follower for during, _ in pairs),
            )
        )
    met = all(float(row[3] or 0.0) < GOAL_TICK for row in rows)
    notes = (
        f"A tick has {1e3 * PERIOD_S:g} ms. Medians over {size.rounds} x {size.segment_s:g} s, each with the "
        f"segments around it; {len(load_rig(RIG).point)} points, one twin and one calibrator.",
        f"Goal: no follower takes more than {GOAL_TICK:g} % of a tick's time from the run, as processor time: "
        f"{'met' if met else 'not met'} here.",
        LADEN,
    )
    columns = (
        "follower",
        "processor ms a tick without",
        "with",
        "more, % of a tick",
        "work of a tick without, ms",
        "with",
        "more, % of a tick",
        "follower, % of a core",
    )
    return ReportTable("followers", "Followers of a run at 10 Hz", columns, tuple(rows), notes)


@contextlib.contextmanager
def _viewing(path: Path, folder: Path, count: int) -> Iterator[list[socket.socket]]:
    """Open viewers' streams on the panel whose address is in `said` of a folder; without viewers there is no panel."""
    if not count:
        yield []
        return
    deadline = time.monotonic() + STARTS_WITHIN_S
    while not (
        found := re.search(r"http://([\d.]+):(\d+)/\?token=(\S+)", (folder / "said").read_text("utf-8", "replace"))
    ):
        if time.monotonic() > deadline:
            raise RuntimeError("the panel of the benchmark does not start")
        time.sleep(0.1)
    host, port, token = found[1], int(found[2]), found[3]
    asked = http.client.HTTPConnection(host, port, timeout=STARTS_WITHIN_S)
    asked.request("GET", f"/?token={token}")
    cookie = (asked.getresponse().getheader("set-cookie") or "").partition(";")[0]
    asked.close()
    request = f"GET /api/runs/{path.name}/stream HTTP/1.1\r\nHost: {host}:{port}\r\nCookie: {cookie}\r\n\r\n"
    with contextlib.ExitStack() as stack:
        viewers = [stack.enter_context(socket.create_connection((host, port))) for _ in range(count)]
        for viewer in viewers:
            viewer.sendall(request.encode())
        yield viewers


def _viewed(size: SinksSize, path: Path, count: int) -> tuple[int, float, float]:
    """Return viewers, states that each got in a second, and the processor time of the panel, s/s."""
    with _started(path.parent, "serve", path, "--port", 0) as panel, _viewing(path, path.parent, count) as viewers:
        _read(viewers, SETTLES_S)
        _require(panel, path.parent)
        began, used = time.monotonic(), processes.ran_s(panel.pid)
        states = _read(viewers, 2.0 * size.segment_s)
        took = time.monotonic() - began
        used = processes.ran_s(panel.pid) - used
    return count, states / max(count, 1) / took, used / took


def _read(viewers: Sequence[socket.socket], seconds: float) -> int:
    """Read what comes for a while; return the number of states."""
    end, states = time.monotonic() + seconds, 0
    while (left := end - time.monotonic()) > 0.0:
        if not viewers:
            time.sleep(left)
            continue
        for viewer in select.select(viewers, [], [], left)[0]:
            data = viewer.recv(1 << 16)
            if not data:
                raise RuntimeError("the panel of the benchmark has closed a viewer's stream")
            states += data.count(b"\ndata: ") + data.startswith(b"data: ")
    return states


def _viewers_table(viewed: Sequence[tuple[int, float, float]]) -> ReportTable:
    rows = tuple((count, each if count else None, 100.0 * share) for count, each, share in viewed)
    most = viewed[-1]
    met = 100.0 * most[2] < GOAL_PANEL
    note = f"Goal: {VIEWERS} viewers at 1 Hz on {GOAL_PANEL:g} % of a core: {'met' if met else 'not met'} here."
    columns = ("viewers", "states a second, each", "panel, % of a core")
    return ReportTable("viewers", "Panel of a run at 10 Hz", columns, rows, (note,))


def _long_run(folder: Path, hours: float) -> Path:
    """Write the folder of a run at 1 Hz with the signals of the virtual rig; return it."""
    path = folder / "runs" / "20260101T000000Z-long"
    path.mkdir(parents=True)
    signals = tuple(point.as_signal() for point in load_rig(RIG).point)
    count, rng = round(3600.0 * hours), np.random.default_rng(0)
    values = 40.0 + np.cumsum(rng.normal(0.0, 0.01, (count, len(signals))), axis=0)
    writer = JournalWriter(path / "journal.sqlite", Header(signals, {}, (), "long", float(count), 1.0, {}))
    quality, source = [0] * len(signals), [0.0] * len(signals)
    for tick, row in enumerate(values.tolist()):
        writer.sample(tick, float(tick), 1.7e9 + tick, 0.003, row, quality, source)
        if tick % COMMIT == COMMIT - 1:
            writer.commit()
    writer.put_meta("exit_status", "done")
    writer.close()
    RunFolder(path).write_manifest(new_manifest({}) | {"exit_status": "done"})
    return path


def _exports(run: Path, folder: Path) -> tuple[list[tuple[str, float, float, float]], tuple[str, ...]]:
    """Return format, wall time, s, processor time, s, and size, MB, of each export; and what cannot be written."""
    rows, skipped = [], []
    for name in FORMATS:
        out = folder / "export" / f"run.{name}"
        out.parent.mkdir(exist_ok=True)
        began, used = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [sys.executable, "-m", "hil", "export", str(run), "--to", name, "--out", str(out)],
            capture_output=True,
            text=True,
            check=False,
        )
        took, ended = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            skipped.append(f"export to {name}: {done.stderr.strip().splitlines()[-1]}")
            continue
        cpu_s = ended.ru_utime + ended.ru_stime - used.ru_utime - used.ru_stime
        written = sum(path.stat().st_size for path in out.parent.iterdir())
        rows.append((name, took, cpu_s, written / 1e6))
        shutil.rmtree(out.parent)
    return rows, tuple(skipped)


def _exports_table(rows: Sequence[tuple[str, float, float, float]], size: SinksSize) -> ReportTable:
    notes = [f"{len(load_rig(RIG).point)} signals; the whole command `hil export`, with its start."]
    if size.hours >= HOURS:
        met = all(row[2] < GOAL_EXPORT_S for row in rows)
        notes += [f"Goal: {GOAL_EXPORT_S:g} s for {HOURS:g} h, as processor time: {'met' if met else 'not met'} here."]
    notes += [LADEN]
    columns = ("format", "s", "processor s", "MB")
    return ReportTable("exports", f"Exports of {size.hours:g} h at 1 Hz", columns, tuple(rows), tuple(notes))
