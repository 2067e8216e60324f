"""`hil resume` as a user types it: a run in processes of its own is killed at any instant and goes on in its folder."""

from __future__ import annotations

import json
import random
import shlex
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.rig_file import file_sha256
from hil.cli.run_commands.resume import command as resume
from hil.diagnosis.columns import read_columns
from hil.journal.writer import JournalReader
from hil.record.reader import Record, read_record
from hil.review.rerun_io import read_words
from hil.run.engine import Outcome
from hil.run.restore.thermal_restore import stores_heat
from hil.run.session.interrupted_run import position_of
from hil.run.session.run import RunResult
from hil.run.session.terminal import interruption_summary
from hil.run_folder.folder import RunFolder, RunFolderError
from hil.testing import Judgement, TestResult, read_plan, write_results
from tests.hil.command_line import typed
from tests.hil.made_plan import plan_text
from twin.segments import LONG_GAP_S, find_segments
from twin.twinfile import load

PROJECT = Path(__file__).resolve().parents[2]
HIL = [sys.executable, "-m", "hil"]
LOAD = """time_s,heater_power_W,pump_speed_pct,fan_speed_pct
0,700,100,70
900,880,100,70
2700,600,85,70
3600,600,85,70
"""
LAST_S = 3600
BEGINNING = "".join(LOAD.splitlines(keepends=True)[:4])
"""The first part of it, for what does not depend on how long a run goes on after its gap."""
NO_SOCKET = shutil.ignore_patterns("control.sock")
TEMPERATURES = ("T_heater_C", "T_pm1_C", "T_radiator_C", "T_tank_C")


def hil(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*HIL, *map(str, arguments)], capture_output=True, text=True, cwd=PROJECT, timeout=240)


def killed(place: Path, after: int, *arguments: object, by: signal.Signals = signal.SIGKILL) -> Path:
    """The folder of a run that SIGKILL, or another signal, ended at or after tick `after`."""
    command = [*HIL, "run", str(place / "load.csv"), "--no-viewer", "--runs", str(place / "runs"), *map(str, arguments)]
    process = subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 180
    try:
        while True:
            journal = next(iter((place / "runs").glob("*/journal.sqlite")), None)
            if journal is not None and last_tick(journal) >= after:
                break
            assert time.monotonic() < deadline and process.poll() is None, process.stderr.read().decode()
            time.sleep(0.1)  # the journal is opened anew each time
        process.send_signal(by)
        process.communicate(timeout=180)
    finally:
        process.kill()
        process.communicate()
    return journal.parent


def last_tick(journal: Path) -> int:
    try:
        reader = JournalReader(journal)
    except Exception:  # the tables are not there yet
        return -1
    try:
        return reader.last()[0]
    finally:
        reader.close()


@dataclass
class Story:
    """A run that nothing disturbed, and one that was killed and resumed; `acknowledged` is what it had journaled."""

    whole: RunFolder
    folder: RunFolder
    acknowledged: dict[str, list[Any]]
    printed: dict[str, Any]
    cut: int


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run without a twin that was killed, for what does not depend on calibrators."""
    place = tmp_path_factory.mktemp("bare")
    (place / "load.csv").write_text(BEGINNING, encoding="utf-8")
    return killed(place, 700, "--virtual", "--lockstep", "--no-twin", "--no-report")


def rows(journal: Path) -> dict[str, list[Any]]:
    """Everything that a journal holds of samples, windows and events."""
    reader = JournalReader(journal)
    try:
        samples = reader.samples()
        return {
            "tick": samples.tick.tolist(),
            "values": samples.values.tolist(),
            "windows": [(row.calibrator, row.end_s, row.document) for row in reader.calibrations()],
            "events": [(row.time_s, row.text) for row in reader.events()],
        }
    finally:
        reader.close()


@pytest.fixture(scope="module")
def story(tmp_path_factory: pytest.TempPathFactory) -> Story:
    place = tmp_path_factory.mktemp("resume")
    (place / "load.csv").write_text(LOAD, encoding="utf-8")
    asked = ("--virtual", "--lockstep", "--seed", 3, "--calibrator", "pso", "--calibrator", "least_squares")
    folder = killed(place, random.randint(700, 1500), *asked)
    acknowledged = rows(folder / "journal.sqlite")
    shutil.copytree(folder, place / "as it was cut", ignore=NO_SOCKET)
    time.sleep(2.0)  # a run that is resumed within its period has no gap
    done = typed("resume", folder, "--no-viewer", "--json")
    assert done.returncode == 0, done.stderr
    whole = typed("run", place / "load.csv", *asked, "--no-viewer", "--runs", place / "whole", "--json")
    assert whole.returncode == 0, whole.stderr
    whole_folder = RunFolder(Path(json.loads(whole.stdout)["folder"]))
    printed = json.loads(done.stdout)
    return Story(whole_folder, RunFolder(folder), acknowledged, printed, acknowledged["tick"][-1])


def test_nothing_that_was_acknowledged_is_lost_or_changed(story):
    now = rows(story.folder.journal)
    count = len(story.acknowledged["tick"])
    assert now["tick"][:count] == story.acknowledged["tick"]
    assert np.array_equal(now["values"][:count], story.acknowledged["values"], equal_nan=True)
    assert now["events"][: len(story.acknowledged["events"])] == story.acknowledged["events"]
    assert now["windows"][: len(story.acknowledged["windows"])] == story.acknowledged["windows"]


def test_the_gap_is_there_for_everyone_to_see(story):
    manifest = story.folder.read_manifest()
    assert (manifest["exit_status"], manifest["safe"]) == ("done", True)
    segment = manifest["segments"][0]
    assert (segment["number"], segment["exit_status"]) == (2, "done")
    assert segment["why"] == "the run was cut while running"
    assert segment["profile_s"] == story.cut
    assert segment["restore_s"] > 120  # a new virtual rig is cold, and the run was cut at a random moment
    record = read_record(story.folder.record)
    jump = int(np.argmax(np.diff(record.time_s)))
    assert record.time_s[jump] == story.cut
    assert np.diff(record.time_s)[jump] == segment["gap_s"] > 1.0
    assert np.array_equal(np.flatnonzero(np.diff(record.columns["segment"])), [jump])
    lane = read_words(story.folder.review, "/state")
    assert [word for _, word in lane] == ["running", "idle", "restoring", "running", "done"]
    idle_s, restoring_s = (time_s for time_s, _ in lane[1:3])
    assert idle_s == story.cut
    # The warm-up begins before the rig is armed, the rows after: on a busy machine that may take a second.
    assert restoring_s <= story.cut + segment["gap_s"] <= restoring_s + 5.0
    assert "<h2>Segments</h2>" in story.folder.report.read_text(encoding="utf-8")
    assert any("segment 2: goes on at" in text for _, text in rows(story.folder.journal)["events"])


def test_profile_time_goes_on_where_it_stood_and_every_second_of_it_is_run_once(story):
    record = read_record(story.folder.record)
    profile_s = record.columns["profile_s"]
    assert profile_s[-1] == LAST_S
    assert sorted(set(profile_s.tolist())) == list(range(LAST_S + 1))
    restoring = (record.time_s > story.cut) & (profile_s == story.cut)
    assert restoring.sum() == pytest.approx(story.printed["segments"][0]["restore_s"], abs=3)


def outside_the_gap(record: Record, cut: int) -> dict[str, np.ndarray]:
    """Columns by second of profile time, without the restore and the ten minutes after it."""
    profile_s = record.columns.get("profile_s", record.time_s)
    moves = np.concatenate([[True], np.diff(profile_s) > 0])
    order = {int(p): i for i, p in enumerate(profile_s) if moves[i]}
    kept = [order[p] for p in range(LAST_S) if not cut - 1 <= p < cut + 600]
    return {name: values[kept] for name, values in record.columns.items()}


def test_outside_the_gap_the_record_is_that_of_a_run_that_nothing_disturbed(story):
    mine, whole = (outside_the_gap(read_record(f.record), story.cut) for f in (story.folder, story.whole))
    before = slice(0, story.cut - 2)
    for name, values in whole.items():
        assert np.array_equal(mine[name][before], values[before], equal_nan=True), name  # lockstep: to the bit
    for name in ("heater_power_set_W", "pump_speed_set_pct", "fan_speed_set_pct"):
        assert np.array_equal(mine[name], whole[name]), name
    after = slice(story.cut - 1, None)
    room = mine["T_ambient_C"][after] - whole["T_ambient_C"][after]
    for name in TEMPERATURES:
        off = mine[name][after] - whole[name][after]
        # The restore may leave a kelvin, and the room is not as warm at another hour.
        assert np.abs(off).max() < 1.0 + np.abs(room).max() + 0.4, name


def test_calibrators_go_on_with_what_they_knew(story):
    before = story.cut // 600 * 600
    kept, whole = ([row for row in rows(f.journal)["windows"] if row[1] <= before] for f in (story.folder, story.whole))
    assert len(kept) >= 2
    assert kept == whole  # a window that was not journaled in time was made again, with the same random numbers
    reader = JournalReader(story.folder.journal)
    ticks = reader.samples().tick
    for twin in ("static", "pso", "least_squares"):
        assert np.array_equal(reader.twin_outputs(twin).tick, ticks), twin
    later = [row for row in reader.calibrations() if row.start_s > story.cut]
    assert next(row.document["window"] for row in later if row.calibrator == "pso") == len(kept) // 2
    reader.close()
    errors = story.printed["errors_K"]
    column = errors["columns"].index("least_squares ahead")
    assert all(cells[column] < 3.0 * errors["noise_K"][sensor] for sensor, cells in errors["rows"].items())


@pytest.mark.parametrize(("name", "where"), [("profile", "load.csv"), ("twin", "twin.toml")])
def test_a_file_that_has_changed_is_refused_by_name(story, tmp_path, name, where):
    shutil.copytree(story.folder.path.parents[1] / "as it was cut", tmp_path / "run")
    changed = tmp_path / where
    source = story.folder.path.parents[1] / "load.csv" if name == "profile" else PROJECT / "profiles/twins/virtual.toml"
    changed.write_text(source.read_text(encoding="utf-8") + "\n# changed\n", encoding="utf-8")
    done = typed("resume", tmp_path / "run", f"--{name}", changed)
    assert done.returncode == 2
    assert f"{changed} is not what it was when the run began; put that {name} back" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert RunFolder(tmp_path / "run").read_manifest()["exit_status"] == "running"
    assert rows(tmp_path / "run" / "journal.sqlite")["tick"] == story.acknowledged["tick"]


def test_the_journal_of_another_run_is_refused(story, tmp_path):
    shutil.copytree(story.folder.path.parents[1] / "as it was cut", tmp_path / "run")
    folder = RunFolder(tmp_path / "run")
    folder.write_manifest(folder.read_manifest() | {"uid": "of another run"})
    done = typed("resume", folder.path)
    assert done.returncode == 2
    assert "is the journal of another run" in done.stderr
    assert rows(folder.journal)["tick"] == story.acknowledged["tick"]


def test_a_file_that_is_gone_is_asked_for(story, tmp_path):
    shutil.copytree(story.folder.path.parents[1] / "as it was cut", tmp_path / "run")
    manifest = RunFolder(tmp_path / "run").read_manifest()
    manifest["files"]["rig"]["path"] = "/nowhere/rig.toml"
    RunFolder(tmp_path / "run").write_manifest(manifest)
    done = typed("resume", tmp_path / "run")
    assert done.returncode == 2
    assert "/nowhere/rig.toml, the run's rig, is not there; give its place with --rig" in done.stderr


def test_a_run_that_is_over_or_goes_on_is_refused(story):
    over = typed("resume", story.folder.path)
    assert (over.returncode, "has run to its end" in over.stderr) == (2, True)
    with story.folder.owned():
        live = hil("resume", story.folder.path)
    assert (live.returncode, "another process makes the files of this run" in live.stderr) == (2, True)
    with story.folder.owned(), pytest.raises(RunFolderError), story.folder.owned():
        pass


def test_a_run_that_a_signal_aborted_goes_on(tmp_path):
    (tmp_path / "load.csv").write_text(BEGINNING, encoding="utf-8")
    folder = RunFolder(killed(tmp_path, 700, "--virtual", "--lockstep", "--no-twin", "--no-report", by=signal.SIGTERM))
    cut = folder.read_manifest()
    assert (cut["exit_status"], cut["safe"]) == ("aborted", True)
    assert typed("report", folder.path).returncode == 0  # whose pages end where the run was cut
    done = typed("resume", folder.path, "--no-viewer", "--json")
    assert done.returncode == 0, done.stderr
    assert folder.is_current(folder.review) and "<h2>Segments</h2>" in folder.report.read_text(encoding="utf-8")
    manifest = folder.read_manifest()
    assert manifest["exit_status"] == "done"
    assert manifest["segments"][0]["why"].startswith("the run aborted (stopped by ")
    profile_s = read_record(folder.record).columns["profile_s"]
    assert sorted(set(profile_s.tolist())) == list(range(2701))


def test_a_run_whose_trip_has_its_cause_still_is_refused_by_name_and_stays_as_it_was(tmp_path):
    (tmp_path / "load.csv").write_text(LOAD, encoding="utf-8")
    effect = '[[effect]]\nkind = "sensor"\nwhere = "T_pm2_C"\ndriver = "constant"\nopen_circuit = true\nonset_s = 300\n'
    (tmp_path / "open.toml").write_text(effect, encoding="utf-8")
    asked = ("--virtual", "--lockstep", "--no-twin", "--with", tmp_path / "open.toml", "--no-viewer", "--no-report")
    tripped = typed("run", tmp_path / "load.csv", *asked, "--runs", tmp_path / "runs")
    assert tripped.returncode == 1
    assert "when its cause is gone, go on with it: " in tripped.stdout
    folder = RunFolder(next((tmp_path / "runs").iterdir()))
    before = rows(folder.journal)
    for _ in range(2):
        refused = typed("resume", folder.path, "--no-viewer")
        assert refused.returncode == 1
        assert "not started: T_pm2 has been without a good value for 5 s: sensor fault" in refused.stdout
    after = rows(folder.journal)
    assert after["values"] == pytest.approx(np.array(before["values"]), nan_ok=True)
    was = position_of(folder)
    assert was.tick == before["tick"][-1]
    assert was.number == 2
    assert set(was.aim) == {s.name for s in JournalReader(folder.journal).header.signals if stores_heat(s)}


def test_a_run_that_was_killed_while_its_report_was_written_gets_it(story, tmp_path):
    shutil.copytree(story.whole.path, tmp_path / "run")
    folder = RunFolder(tmp_path / "run")
    folder.report.unlink()
    folder.record.unlink()
    refused = typed("resume", folder.path, "--no-viewer")
    assert refused.returncode == 2
    assert f"has run to its end; `hil report {folder.path}` makes its record and report" in refused.stderr
    done = typed("report", folder.path)
    assert done.returncode == 0, done.stderr
    record, whole = read_record(folder.record), read_record(story.whole.record)
    assert np.array_equal(record.columns["T_tank_C"], whole.columns["T_tank_C"])
    assert folder.report.is_file()


def clock_moved(source: Path, to: Path, **changes: float | str) -> None:
    """A copy of the cut run whose rows are older, or whose note of the clocks is another."""
    shutil.copytree(source, to, ignore=NO_SOCKET)
    with sqlite3.connect(to / "journal.sqlite") as database:
        if "older_s" in changes:
            database.execute("UPDATE samples SET wall_s = wall_s - ?", (changes.pop("older_s"),))
        noted = json.loads(database.execute("SELECT value FROM meta WHERE key = 'clock'").fetchone()[0])
        database.execute("UPDATE meta SET value = ? WHERE key = 'clock'", (json.dumps(noted | changes),))
    database.close()


def test_a_gap_of_ten_years_is_questioned_and_the_stated_one_is_taken(bare, tmp_path):
    ten_years_s = 10 * 365.25 * 86400
    clock_moved(bare, tmp_path / "run", older_s=ten_years_s)
    before = rows(tmp_path / "run" / "journal.sqlite")
    refused = typed("resume", tmp_path / "run", "--no-viewer")
    assert refused.returncode == 2
    assert "longer than 7 d" in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1
    assert rows(tmp_path / "run" / "journal.sqlite") == before
    done = typed("resume", tmp_path / "run", "--gap", "12min", "--timeout", 60, "--no-viewer", "--json")
    assert json.loads(done.stdout)["segments"][0]["gap_s"] == pytest.approx(720.0, abs=60.0)


def test_a_wall_clock_that_jumped_within_a_boot_is_told_and_changes_no_gap(bare, tmp_path):
    noted = 5 * 86400.0
    with sqlite3.connect(bare / "journal.sqlite") as database:
        clock = json.loads(database.execute("SELECT value FROM meta WHERE key = 'clock'").fetchone()[0])
    database.close()
    # As if the clock had been five days behind while the run went on, and then been set right.
    clock_moved(bare, tmp_path / "run", older_s=noted, wall_at_boot_s=clock["wall_at_boot_s"] - noted)
    done = typed("resume", tmp_path / "run", "--timeout", 60, "--no-viewer", "--json")
    assert json.loads(done.stdout)["segments"][0]["gap_s"] < 3600.0


def test_a_run_that_was_cut_is_told_from_one_that_goes_on(story):
    cut = RunFolder(story.folder.path.parents[1] / "as it was cut")
    assert cut.was_cut
    assert not story.folder.was_cut
    with cut.owned():
        assert not cut.was_cut
    refused = typed("diagnose", cut.path, "--dry")
    assert refused.returncode == 2
    name = shlex.quote(str(cut.path))
    assert f"because the run was interrupted; `hil resume {name}` continues it" in refused.stderr
    assert f"`hil report {name}` makes the record" in refused.stderr
    shown = typed("review", cut.path).stderr
    assert f"the run was interrupted: shown as far as it came; `hil resume {shlex.quote(str(cut.path))}`" in shown


def test_a_resumed_run_is_diagnosed_on_both_sides_of_the_gap_and_says_what_it_cost(story):
    network = load(story.folder.twin)
    columns, messages = read_columns(network, story.folder.record, None)
    record = read_record(story.folder.record)
    first = record.columns["segment"] == 1
    assert np.array_equal(columns.time_s, record.time_s)
    found = find_segments(network, columns.time_s, columns.inputs)
    ((left, anew),) = found.gaps
    assert left == record.time_s[first][-1]
    assert anew > left + LONG_GAP_S
    assert not np.isfinite(columns.measured[~first & (record.time_s < anew)]).any()
    assert not any("longest segment" in message for message in messages)
    whole, messages = read_columns(network, story.whole.record, None)
    assert len(whole.time_s) == LAST_S + 1
    assert not any("cut" in message for message in messages)
    said = interruption_summary(story.folder.read_manifest())
    assert said.startswith(" (cut once: ")
    assert said.endswith("of thermal restore)")
    assert interruption_summary(story.whole.read_manifest()) == ""


def test_a_restore_that_takes_too_long_ends_safe_and_can_be_tried_again(bare, tmp_path):
    shutil.copytree(bare, tmp_path / "run", ignore=NO_SOCKET)
    cut = last_tick(bare / "journal.sqlite")
    for attempt in range(2):
        done = typed("resume", tmp_path / "run", "--timeout", 60, "--no-viewer", "--json")
        assert done.returncode == 1, done.stderr
        manifest = json.loads(done.stdout)
        assert (manifest["exit_status"], manifest["safe"]) == ("faulted", True)
        assert manifest["reason"].startswith("not resumed: after 60 s of thermal restore T_")
        assert len(manifest["segments"]) == attempt + 1
        # The aim is still where the rig was when the profile's clock went.
        assert manifest["segments"][-1]["profile_s"] == cut


def test_a_rig_that_goes_on_by_itself_is_safe_when_its_watchdog_runs_out_and_is_resumed_warm(tmp_path):
    (tmp_path / "load.csv").write_text(BEGINNING, encoding="utf-8")
    ports = [_free_port() for _ in range(3)]
    names = ("--modbus-port", "--can-port", "--control-port")
    arguments = [str(item) for pair in zip(names, ports, strict=True) for item in pair]
    text = (PROJECT / "profiles/rigs/virtual.toml").read_text(encoding="utf-8")
    for old, new in (
        ("port = 5020", f"port = {ports[0]}"),
        ("port = 29536", f"port = {ports[1]}"),
        ('"thermocouples.dbc"', f'"{PROJECT}/profiles/rigs/thermocouples.dbc"'),
    ):
        text = text.replace(old, new)
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    server = subprocess.Popen([*HIL, "rig", "--mode", "lockstep", *arguments], cwd=PROJECT, stdout=subprocess.PIPE)
    try:
        assert server.stdout is not None
        assert b"Virtual rig" in server.stdout.readline()
        control = f"127.0.0.1:{ports[2]}"
        folder = killed(tmp_path, 700, "--rig", tmp_path / "rig.toml", "--control", control, "--no-twin", "--no-report")
        assert _heater(ports[0]) > 600.0
        deadline = time.monotonic() + 20
        while _heater(ports[0]) > 0.0:  # nobody beats the heart
            assert time.monotonic() < deadline
            time.sleep(0.2)
        done = typed("resume", folder, "--no-viewer", "--json")
        assert done.returncode == 0, done.stderr
        manifest = json.loads(done.stdout)
        assert manifest["exit_status"] == "done"
        assert 60.0 <= manifest["segments"][0]["restore_s"] < 600.0  # it had not cooled far
        assert _heater(ports[0]) == 0.0
    finally:
        server.terminate()
        server.communicate(timeout=20)


def _heater(port: int) -> float:
    """Set-point of the heater as the PLC holds it, W, by a client of our own."""
    with socket.create_connection(("127.0.0.1", port), timeout=5) as client:
        client.sendall(bytes.fromhex("000100000006010300000001"))
        return int.from_bytes(client.recv(64)[9:11], "big") * 0.1


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def test_a_resume_takes_back_what_the_manifest_says_of_an_earlier_end(story, tmp_path, monkeypatch):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(story.folder.path.parents[1] / "as it was cut", folder.path)
    old = {"exit_status": "faulted", "reason": "a trip", "safe": True, "away": "", "guardian": "cut", "trips": ["hot"]}
    folder.write_manifest(folder.read_manifest() | old)
    seen = {}

    async def killed_at_once(prepared):
        seen.update(folder.read_manifest())
        raise RunFolderError("killed here")

    monkeypatch.setattr("hil.run.session.session.carry_out", killed_at_once)
    done = CliRunner().invoke(resume, [str(folder.path), "--no-viewer"])
    assert seen, done.output
    assert seen["exit_status"] == "running"
    assert not {"safe", "away", "guardian", "trips", "problems", "deviations"} & set(seen)


def test_a_resumed_test_ends_with_its_verdict(bare, tmp_path, monkeypatch):
    folder = RunFolder(tmp_path / "run")
    shutil.copytree(bare, folder.path, ignore=NO_SOCKET)
    plan = tmp_path / "plan.toml"
    plan.write_text(plan_text("no trip"), encoding="utf-8")
    manifest = folder.read_manifest()
    manifest["files"]["test"] = {"path": str(plan), "sha256": file_sha256(plan)}
    folder.write_manifest(manifest)

    async def judged(prepared):
        write_results(prepared.folder, TestResult(read_plan(plan), (Judgement(limit, "fail", "too hot"),)))
        return RunResult(prepared.folder, Outcome("done", "the profile is over", 10, safe=True), None, 9.0, 1.0, False)

    (limit,) = read_plan(plan).limits
    monkeypatch.setattr("hil.run.session.session.carry_out", judged)
    done = CliRunner().invoke(resume, [str(folder.path), "--no-viewer"])
    assert done.exit_code == 1, done.output
    assert "FAIL          L1  no trip: too hot" in done.output
