"""A record and its twin, named one by one or by a run's folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.cli.options.subject import RecordAndTwin, SubjectError, subject_of


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "a_run"
    folder.mkdir()
    for name in ("record.parquet", "twin.toml"):
        (folder / name).write_bytes(b"")
    return folder


def test_a_run_brings_its_twin_and_takes_another(run: Path, tmp_path: Path) -> None:
    assert subject_of(run, None) == RecordAndTwin(run / "record.parquet", run / "twin.toml", run)
    other = tmp_path / "other.toml"
    other.write_bytes(b"")
    assert subject_of(run, other).twin == other
    assert subject_of(run, None).diagnosis == run / "diagnosis"


def test_a_record_needs_a_twin_and_is_diagnosed_beside_the_shell(run: Path) -> None:
    with pytest.raises(SubjectError, match="--twin"):
        subject_of(run / "record.parquet", None)
    subject = subject_of(run / "record.parquet", run / "twin.toml")
    assert subject.run is None and subject.diagnosis == Path("diagnosis-a_run-record")


def test_a_folder_that_lacks_something_is_said_to(run: Path) -> None:
    (run / "twin.toml").unlink()
    with pytest.raises(SubjectError, match=r"no twin\.toml"):
        subject_of(run, None)
    (run / "record.parquet").unlink()
    with pytest.raises(SubjectError, match=r"no record\.parquet"):
        subject_of(run, None)
