"""A rig that measures no pump or fan speed: a run's twin takes the set-points, as `commission` and `diagnose` do."""

from __future__ import annotations

import re
import shutil
import sqlite3
from pathlib import Path

import pytest

from drivers.signals.points import ConfigurationError
from hil.run.session.request import RunRequest, prepare
from tests.hil.command_line import typed

PROFILES = Path(__file__).resolve().parents[2] / "profiles"
VIRTUAL = PROFILES / "rigs" / "virtual.toml"
TWIN = PROFILES / "twins" / "loop.toml"
LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,500,100,70\n200,500,60,70\n900,500,60,70\n"


def rig_without(folder: Path, *names: str) -> Path:
    """The virtual rig's file without the measured points `names`; the set-points have these names."""
    parts = VIRTUAL.read_text(encoding="utf-8").split("[[point]]")
    text = "[[point]]".join(part for part in parts if not any(f'\nname = "{name}"\n' in part for name in names))
    for name in names:
        text = re.sub(rf'readback = "{name}"\nreadback_tolerance = .*\n', "", text)
        text = text.replace(f'"{name}_set"', f'"{name}"')
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    shutil.copy(VIRTUAL.with_name("thermocouples.dbc"), folder)
    (folder / "load.csv").write_text(LOAD, encoding="utf-8")
    return path


def request(folder: Path, rig: Path) -> RunRequest:
    return RunRequest(folder / "load.csv", rig, TWIN, folder / "runs")


def test_an_input_that_is_only_commanded_is_noted(tmp_path):
    notes = prepare(request(tmp_path, rig_without(tmp_path, "pump_speed", "fan_speed"))).notes
    taken = [note for note in notes if "the twin takes the set-point" in note]
    assert [note.split()[0] for note in taken] == ["pump_speed_pct", "fan_speed_pct"]


def test_nothing_is_noted_where_all_is_measured(tmp_path):
    notes = prepare(request(tmp_path, rig_without(tmp_path))).notes
    assert not any("set-point" in note for note in notes)


def test_a_sensor_cannot_be_a_set_point_and_an_input_must_be_somewhere(tmp_path):
    path = rig_without(tmp_path, "pump_speed")
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('name = "pump_speed"', 'name = "pump"'), encoding="utf-8")
    (tmp_path / "load.csv").write_text(LOAD.replace("pump_speed_pct", "pump_pct"), encoding="utf-8")
    with pytest.raises(
        ConfigurationError, match="call the set-point that stands for pump_speed_pct as the twin's input"
    ):
        prepare(request(tmp_path, path))


def test_the_twin_of_a_run_follows_the_set_points(tmp_path):
    rig = rig_without(tmp_path, "pump_speed", "fan_speed")
    done = typed(
        "run",
        tmp_path / "load.csv",
        "--rig",
        rig,
        "--twin",
        TWIN,
        "--virtual",
        "--lockstep",
        "--no-viewer",
        "--no-report",
        "--calibrator",
        "least_squares",
        "--runs",
        tmp_path / "runs",
    )
    assert done.returncode == 0, done.stderr
    assert "pump_speed_pct is not measured on" in done.stderr
    (journal,) = (tmp_path / "runs").glob("*/journal.sqlite")
    with sqlite3.connect(journal) as open_journal:
        (predictions,) = open_journal.execute("select count(distinct tick) from twins").fetchone()
    assert predictions > 800
