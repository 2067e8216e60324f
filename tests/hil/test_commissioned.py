"""The record that a twin was commissioned on stays with it: beside revisions, in run folders, and not if it changed."""

from __future__ import annotations

import datetime
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.diagnosis.healthy_record import commissioned_on, copy_record, healthy_path, save_with_record
from hil.record.reader import Record, read_record
from twin.network import TwinFileError
from twin.revisions import save_revision
from twin.twinfile import load

PROJECT = Path(__file__).resolve().parents[2]
START = datetime.datetime(2026, 3, 1, 8, 30, tzinfo=datetime.UTC)


@pytest.fixture
def twin(tmp_path: Path) -> Path:
    """A twin saved with a record that holds a column nobody asked for, and begins at half past eight."""
    network = load(PROJECT / "profiles" / "twins" / "loop.toml")
    time_s = np.arange(0.0, 7200.0, 2.0)
    names = [*network.input_columns, *(c for s in network.sensors for c in s.measured), "door_open"]
    columns = {name: np.full(len(time_s), 20.0 + k) for k, name in enumerate(names)}
    columns["T_tank_C"][100:110] = np.nan
    path = tmp_path / "mine" / "rig.toml"
    path.parent.mkdir()
    save_with_record(network, Record(time_s, columns, start=START), path)
    return path


def test_what_the_twin_reads_is_kept_with_the_time_of_day(twin: Path) -> None:
    kept = commissioned_on(twin)
    assert kept.path == healthy_path(twin) == twin.with_name("rig.healthy.parquet") and not kept.why
    record = read_record(healthy_path(twin))
    assert "door_open" not in record.columns and np.isnan(record.columns["T_tank_C"]).sum() == 10
    assert record.columns["time_of_day_h"][[0, -1]] == pytest.approx([8.5, 8.5 + 7198.0 / 3600.0])


def test_a_revision_has_the_record_of_what_it_was_made_of(twin: Path) -> None:
    network = load(twin)
    revision = save_revision(network.with_values({"tank.capacitance": 1.5e5}), twin)
    assert load(revision).revision.record == ""
    assert commissioned_on(revision).path == healthy_path(twin)


def test_a_run_folder_holds_it_beside_its_copies(twin: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    revision = save_revision(load(twin).with_values({"tank.capacitance": 1.5e5}), twin)
    shutil.copyfile(revision, folder / "twin.toml")
    shutil.copyfile(twin, folder / "twin.before-1.toml")
    copy_record(revision, folder)
    assert commissioned_on(folder / "twin.toml").path == folder / "rig.healthy.parquet"


def test_a_record_that_is_gone_or_another_is_not_used_and_said(twin: Path) -> None:
    content = healthy_path(twin).read_bytes()
    healthy_path(twin).write_bytes(content + b" ")
    kept = commissioned_on(twin)
    assert kept.path is None and "has changed since rig.toml was commissioned on it" in kept.why
    healthy_path(twin).unlink()
    kept = commissioned_on(twin)
    assert kept.path is None and "rig.healthy.parquet" in kept.why and "--healthy" in kept.why


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    network = load(PROJECT / "profiles" / "twins" / "loop.toml")
    record = Record(np.arange(3.0), {"T_tank_C": np.full(3, 20.0)})
    with pytest.raises(TwinFileError, match="--out another folder"):
        save_with_record(network, record, tmp_path / "nowhere" / "rig.toml")


def test_a_twin_that_was_never_commissioned_has_none(tmp_path: Path) -> None:
    network = load(PROJECT / "profiles" / "twins" / "loop.toml")
    assert network.revision == replace(network.revision, record="")
    assert commissioned_on(PROJECT / "profiles" / "twins" / "loop.toml").path is None


def test_the_shipped_twin_has_the_record_that_it_was_commissioned_on() -> None:
    assert commissioned_on(PROJECT / "profiles" / "twins" / "virtual.toml").path is not None
