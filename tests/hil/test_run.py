"""`hil run` as a user types it: separate processes, real Modbus and CAN, a run folder that holds together."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.signals.points import Quality
from hil.journal.writer import JournalReader
from hil.record.reader import read_record
from hil.report.page import measured_sensors
from hil.review import ViewerError, read_columns, screenshot
from hil.run_folder.folder import RunFolder
from tests.hil.command_line import typed

PROJECT = Path(__file__).resolve().parents[2]
HIL = [sys.executable, "-m", "hil"]
LOAD = """time_s,heater_power_W,pump_speed_pct,fan_speed_pct
0,700,100,70
900,850,85,70
1500,650,100,100
{end},650,100,100
"""
BRIEF = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,300,100,70\n{end},300,100,70\n"
HEAT = '[[effect]]\nkind = "heat_source"\nwhere = "modules"\ndriver = "constant"\npower_W = 180\nonset_s = 605\n'


def hil(*arguments: object, cwd: Path = PROJECT) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*HIL, *map(str, arguments)], capture_output=True, text=True, cwd=cwd, timeout=240)


@dataclass
class Finished:
    folder: RunFolder
    printed: dict[str, Any]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """A run of 50 minutes in which the modules begin to heat after ten."""
    place = tmp_path_factory.mktemp("run")
    (place / "load.csv").write_text(LOAD.format(end=3000), encoding="utf-8")
    (place / "heat.toml").write_text(HEAT, encoding="utf-8")
    done = hil(
        "run",
        place / "load.csv",
        "--virtual",
        "--lockstep",
        "--runs",
        place / "runs",
        "--json",
        "--with",
        place / "heat.toml",
        "--calibrator",
        "pso",
        "--calibrator",
        "least_squares",
        "--seed",
        3,
    )
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout)
    return Finished(RunFolder(Path(printed["folder"])), printed)


def test_the_folder_holds_everything_and_says_what_it_came_from(finished):
    names = {path.name for path in finished.folder.path.iterdir()}
    kept = {"twin.toml", "twin.before-1.toml", "virtual.healthy.parquet"}
    assert names == {"run.json", "journal.sqlite", "record.parquet", "review.rrd", "report.html"} | kept
    manifest = finished.folder.read_manifest()
    assert (manifest["exit_status"], manifest["safe"], manifest["ticks"]) == ("done", True, 3000)
    assert set(manifest["files"]) == {"rig", "profile", "twin", "effects", "dbc of thermocouples"}
    assert all(len(item["sha256"]) == 64 for item in manifest["files"].values())
    assert manifest["settings"]["seed"] == 3


def test_the_tracked_twin_follows_what_the_static_one_cannot_know(finished):
    errors = finished.printed["errors_K"]
    columns = errors["columns"]
    assert columns == ["static", "pso ahead", "pso fitted", "least_squares ahead", "least_squares fitted"]
    for sensor, cells in errors["rows"].items():
        row = dict(zip(columns, cells, strict=True))
        assert row["static"] > 0.5, sensor
        assert row["pso ahead"] < 0.6 * row["static"], sensor
        assert row["pso fitted"] < 4.0 * errors["noise_K"][sensor], sensor
        assert row["least_squares fitted"] < 1.6 * errors["noise_K"][sensor], sensor


def test_the_operator_is_told_where_something_entered_the_rig(finished):
    reader = JournalReader(finished.folder.journal)
    warnings = [(row.time_s, row.text) for row in reader.events() if row.level == "WARN"]
    reader.close()
    time_s, text = warnings[0]
    assert time_s == pytest.approx(1200, abs=2)  # the end of the first window after it began
    assert "pso: modules give off" in text
    assert "that the twin does not model, from" in text


def test_the_table_is_that_of_the_journal(finished):
    reader = JournalReader(finished.folder.journal)
    samples = reader.samples()
    measured = measured_sensors(reader, samples)
    columns = finished.printed["errors_K"]["columns"]
    for twin, column in (("static", "static"), ("pso", "pso ahead"), ("least_squares", "least_squares ahead")):
        outputs = reader.twin_outputs(twin)
        assert np.array_equal(outputs.tick, samples.tick)
        for position, (sensor, values) in enumerate(measured.items()):
            table = finished.printed["errors_K"]["rows"][sensor][columns.index(column)]
            later = samples.time_s > 60
            rmse = np.sqrt(np.nanmean((values - outputs.values[:, position])[later] ** 2))
            assert rmse == pytest.approx(table, rel=0.05), (twin, sensor)
    reader.close()


def test_record_and_review_equal_the_journal_sample_for_sample(finished):
    reader = JournalReader(finished.folder.journal)
    samples = reader.samples()
    record = read_record(finished.folder.record)
    assert np.array_equal(record.time_s, samples.time_s)
    for index, signal_ in enumerate(reader.header.signals):
        good = samples.quality[:, index] == Quality.GOOD
        assert np.array_equal(record.columns[signal_.column][good], samples.values[good, index]), signal_.column
    for sensor, columns in reader.header.twin_sensors.items():
        if len(columns) > 1:
            continue
        time_s, values = read_columns(finished.folder.review, f"/sensors/{sensor}/measured")
        assert np.array_equal(time_s, samples.time_s)
        index = [s.column for s in reader.header.signals].index(columns[0])
        assert np.array_equal(values.reshape(len(time_s), -1)[:, 0], samples.values[:, index])
    reader.close()


def test_a_picture_of_the_review_has_no_complaints(finished, tmp_path):
    try:
        problems = screenshot(finished.folder.review, tmp_path / "review.png")
    except ViewerError as error:
        pytest.skip(f"no headless viewer here: {error}")
    assert problems == []
    assert (tmp_path / "review.png").stat().st_size > 20_000


def test_tracking_the_record_again_gives_the_same_table(finished):
    done = typed(
        "track",
        finished.folder.record,
        "--twin",
        finished.folder.twin,
        "--seed",
        3,
        "--calibrator",
        "pso",
        "--calibrator",
        "least_squares",
        "--json",
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["errors_K"]["rows"] == finished.printed["errors_K"]["rows"]


def test_a_signal_while_files_are_made_leaves_the_record_and_says_how_to_make_the_rest(tmp_path):
    (tmp_path / "load.csv").write_text(BRIEF.format(end=300), encoding="utf-8")
    command = [*HIL, "run", str(tmp_path / "load.csv"), "--virtual", "--lockstep", "--no-twin", "--no-viewer"]
    process = subprocess.Popen(
        [*command, "--runs", str(tmp_path / "runs")], cwd=PROJECT, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("writing review.rrd"):
            process.send_signal(signal.SIGTERM)
            break
    _, said = process.communicate(timeout=180)
    assert process.returncode == 128 + signal.SIGTERM, said
    folder = RunFolder(next((tmp_path / "runs").iterdir()))
    assert "not made: review.rrd (stopped by SIGTERM); report.html (stopped by SIGTERM); `" in said
    assert f"report {folder.path}` makes them from the journal" in said
    assert "Traceback" not in said
    manifest = folder.read_manifest()
    assert (manifest["exit_status"], set(manifest["missing"])) == ("done", {"review.rrd", "report.html"})
    assert len(read_record(folder.record).time_s) == 301
    assert not list(folder.path.glob(".*"))
    assert typed("report", folder.path).returncode == 0
    assert folder.review.is_file()
    assert folder.report.is_file()


@pytest.mark.parametrize(
    ("number", "twin"),
    [
        (signal.SIGINT, ["--calibrator", "pso"]),
        (signal.SIGTERM, ["--calibrator", "least_squares"]),
        (signal.SIGHUP, ["--no-twin"]),
        (signal.SIGQUIT, ["--no-twin"]),
    ],
)
def test_a_signal_ends_the_run_with_the_heater_safe(tmp_path, number, twin):
    (tmp_path / "load.csv").write_text(LOAD.format(end=40000), encoding="utf-8")
    command = [*HIL, "run", str(tmp_path / "load.csv"), "--virtual", "--speed", "10", "--runs", str(tmp_path)]
    process = subprocess.Popen(
        [*command, *twin, "--no-viewer", "--no-report"],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        process_group=0,
    )
    journal = None
    deadline = time.monotonic() + 180
    while time.monotonic() < deadline:
        journal = next(iter(tmp_path.glob("*-load/journal.sqlite")), None)
        if journal is not None and _ticks(journal) > 30:
            break
        assert process.poll() is None, process.stderr.read().decode()
        time.sleep(0.2)
    if number in (signal.SIGINT, signal.SIGQUIT):
        os.killpg(process.pid, number)  # Ctrl-C reaches the virtual rig and the calibrators too
    else:
        process.send_signal(number)
    out, err = process.communicate(timeout=180)
    assert process.returncode == 1, err.decode()
    assert "Traceback" not in err.decode()
    manifest = RunFolder(journal.parent).read_manifest()
    assert (manifest["exit_status"], manifest["safe"]) == ("aborted", True)
    assert "stopped" in manifest["reason"]
    assert "aborted" in out.decode()


def test_a_rig_that_runs_already_is_taken_over_in_lockstep(tmp_path):
    ports = {"--modbus-port": _free_port(), "--can-port": _free_port(), "--control-port": _free_port()}
    arguments = [str(item) for pair in ports.items() for item in pair]
    rig = tmp_path / "rig.toml"
    text = (PROJECT / "profiles/rigs/virtual.toml").read_text(encoding="utf-8")
    text = text.replace("port = 5020", f"port = {ports['--modbus-port']}")
    text = text.replace("port = 29536", f"port = {ports['--can-port']}")
    text = text.replace('"thermocouples.dbc"', f'"{PROJECT}/profiles/rigs/thermocouples.dbc"')
    rig.write_text(
        text.replace('"../twins/virtual.toml"', f'"{PROJECT}/profiles/twins/virtual.toml"'), encoding="utf-8"
    )
    (tmp_path / "load.csv").write_text(BRIEF.format(end=300), encoding="utf-8")
    server = subprocess.Popen([*HIL, "rig", "--mode", "lockstep", *arguments], cwd=PROJECT, stdout=subprocess.PIPE)
    try:
        assert server.stdout is not None
        assert b"Virtual rig" in server.stdout.readline()
        for _ in range(2):
            done = typed(
                "run",
                tmp_path / "load.csv",
                "--rig",
                rig,
                "--control",
                f"127.0.0.1:{ports['--control-port']}",
                "--runs",
                tmp_path / "runs",
                "--no-twin",
                "--no-viewer",
                "--no-report",
                "--json",
            )
            assert done.returncode == 0, done.stderr
            assert json.loads(done.stdout)["ticks"] == 300
            folder = RunFolder(Path(json.loads(done.stdout)["folder"]))
            assert folder.record.is_file() and not folder.review.exists() and not folder.report.exists()
            assert folder.read_manifest()["missing"] == {}
    finally:
        server.terminate()
        server.communicate(timeout=20)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _ticks(journal: Path) -> int:
    try:
        reader = JournalReader(journal)
    except Exception:
        return 0
    count = len(reader.samples().tick)
    reader.close()
    return count


@pytest.mark.parametrize("rig_names_a_twin", [True, False])
def test_a_run_shorter_than_a_window_goes_without_a_twin(tmp_path, rig_names_a_twin):
    load = tmp_path / "load.csv"
    load.write_text(BRIEF.format(end=20), encoding="utf-8")
    rig, shipped = tmp_path / "rig.toml", PROJECT / "profiles" / "rigs"
    named = (shipped / "virtual.toml").read_text(encoding="utf-8")
    assert 'twin = "../twins/virtual.toml"' in named
    twin = f'twin = "{shipped.parent}/twins/virtual.toml"' if rig_names_a_twin else ""
    rig.write_text(named.replace('twin = "../twins/virtual.toml"', twin), encoding="utf-8")
    (tmp_path / "thermocouples.dbc").write_bytes((shipped / "thermocouples.dbc").read_bytes())
    asked = ("run", load, "--rig", rig, "--virtual", "--lockstep", "--no-viewer", "--runs", tmp_path / "runs", "--json")
    if rig_names_a_twin:
        for refused in (typed(*asked), typed("check", load, "--rig", rig)):
            assert refused.returncode == 2
            assert "load.csv lasts 20 s" in refused.stderr and "(hil run --no-twin)" in refused.stderr
        assert not (tmp_path / "runs").exists()
        asked += ("--no-twin",)
    else:
        assert typed("check", load, "--rig", rig).returncode == 0
    done = typed(*asked)
    assert done.returncode == 0, done.stderr
    folder = RunFolder(Path(json.loads(done.stdout)["folder"]))
    assert folder.read_manifest()["exit_status"] == "done"
    assert folder.report.is_file() and read_record(folder.record).time_s[-1] == 20.0
