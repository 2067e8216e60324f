"""Record of a run whose journal goes on: a resumption that was killed leaves the record of the first part."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from hil.cli.options.paths import RecordFile
from hil.cli.options.subject import SubjectError, record_of, subject_of
from hil.cli.rig_commands.check import command as check
from hil.cli.twin_commands.track import command as track
from hil.export.run_export import export_run
from hil.journal.export import export_record
from hil.run.session.regenerate import regenerate_files
from hil.run_folder.folder import RunFolder
from tests.hil.ended_run import ended_run

ALL, FIRST = 300, 200
LATER = pytest.mark.parametrize("later", [-3600.0, 3600.0], ids=["older file", "file of a copied folder"])
"""Seconds from now to the time of the record's file: a copy of a folder may have any times."""


def cut_record(path: Path, *, ended: bool = True, later: float = -3600.0) -> RunFolder:
    """Return a run of 300 ticks with the record of its first 200."""
    folder, manifest = ended_run(path, ticks=ALL, ended=ended)
    folder.write_manifest(manifest)
    shutil.copyfile(Path(__file__).resolve().parents[2] / "profiles/twins/virtual.toml", folder.twin)
    first, _ = ended_run(path.with_name("first"), ticks=FIRST)
    export_record(first.journal, folder.record)
    os.utime(folder.record, (time.time() + later,) * 2)
    return folder


def rows(path: Path) -> int:
    return int(pq.read_metadata(path).num_rows)


@LATER
def test_the_record_of_an_ended_run_gets_the_ticks_that_it_lacks(tmp_path, later, capsys):
    folder = cut_record(tmp_path / "run", later=later)
    assert rows(folder.record) == FIRST
    assert subject_of(folder.path, None).record == folder.record
    assert rows(folder.record) == ALL
    assert "lacked the last ticks of journal.sqlite" in capsys.readouterr().err
    made = folder.record.stat().st_mtime_ns
    record_of(folder.path)
    assert folder.record.stat().st_mtime_ns == made


@pytest.mark.parametrize("named", [record_of, lambda path: RecordFile().convert(path, None, None)])
def test_a_record_that_is_named_as_a_file_is_checked_too(tmp_path, named):
    folder = cut_record(tmp_path / "run")
    assert named(folder.record) == folder.record
    assert rows(folder.record) == ALL


@LATER
def test_the_record_of_an_interrupted_run_is_refused_until_a_report_makes_it(tmp_path, later):
    folder = cut_record(tmp_path / "run", ended=False, later=later)
    with pytest.raises(SubjectError, match=r"lacks the last ticks of .*`hil resume .* and `hil report .* makes"):
        record_of(folder.path)
    assert rows(folder.record) == FIRST
    regenerate_files(folder, False, lambda text: None)
    assert rows(record_of(folder.path)) == ALL


def test_the_record_of_a_resumed_run_that_goes_on_is_refused(tmp_path):
    folder = cut_record(tmp_path / "run", ended=False)
    with folder.owned(), pytest.raises(SubjectError, match="still goes on"):
        record_of(folder.path)
    assert rows(folder.record) == FIRST


def test_a_changed_copy_of_a_record_is_kept_where_it_is_newer_than_the_journal(tmp_path):
    folder = cut_record(tmp_path / "run")
    chosen = pq.read_table(folder.record).slice(0, 50).replace_schema_metadata(None)
    pq.write_table(chosen, folder.record)
    os.utime(folder.record, (time.time() + 3600.0,) * 2)
    assert rows(record_of(folder.path)) == 50


def test_a_folder_that_cannot_be_written_is_refused_with_the_reason(tmp_path, monkeypatch):
    def fails(*_: object) -> None:
        raise OSError(28, "No space left on device")

    folder = cut_record(tmp_path / "run")
    monkeypatch.setattr("hil.run.session.regenerate.export_record", fails)
    with pytest.raises(SubjectError, match=r"lacks the last ticks of journal\.sqlite, and none can be made .*No space"):
        record_of(folder.path)


def test_an_export_is_of_the_journal_and_not_of_the_record(tmp_path):
    folder = cut_record(tmp_path / "run")
    (made,) = export_run(folder.path, "parquet", tmp_path / "exported.parquet")
    assert (rows(made), rows(folder.record)) == (ALL, FIRST)


def test_the_commands_read_every_tick(tmp_path):
    checked = CliRunner().invoke(check, [str(cut_record(tmp_path / "a" / "run").record)])
    assert f"record.parquet: {ALL} samples" in checked.output, checked.output
    folder = cut_record(tmp_path / "b" / "run")
    out = tmp_path / "predicted.parquet"
    tracked = CliRunner().invoke(track, [str(folder.path), "--calibrator", "least_squares", "--out", str(out)])
    assert tracked.exit_code == 0, tracked.output
    assert isinstance(pq.read_table(out), pa.Table) and rows(out) == ALL
