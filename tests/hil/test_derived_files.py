"""Files made after a run: each by itself, also when one fails, a signal comes, or the folder is moved or deleted."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import sqlite3
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from drivers.rig_file import file_sha256
from hil.cli.options.subject import SubjectError, subject_of
from hil.cli.rig_commands.check import command as check
from hil.cli.run_commands.report import command as report
from hil.cli.twin_commands.commission import command as commission
from hil.diagnosis.store import CURVES, curves_of, write_curves, write_document
from hil.errors import exit_code
from hil.journal.writer import JournalWriter
from hil.record.reader import RecordError
from hil.review import write_review
from hil.run.engine import Outcome
from hil.run.session.derived_files import DerivedFiles, derive_files, missing_sentence
from hil.run.session.interrupted_run import request_of
from hil.run.session.manifest import END_KEYS, END_OF_RUN, RUN_UID, TWIN_KEYS, end_entries, twin_entries
from hil.run.session.regenerate import regenerate_files
from hil.run_folder import read_verdict
from hil.run_folder.folder import FolderLostError, RunFolderError
from hil.run_folder.manifest_check import left_safe
from hil.tracking import Comparison, ErrorTable
from tests.hil.ended_run import ended_run
from tests.hil.made_diagnosis import SENSORS
from tests.hil.made_diagnosis import made as diagnosis
from tests.hil.made_plan import plan_text
from tests.hil.synthetic_journal import make, narrowed

ALL = {"run.json", "journal.sqlite", "record.parquet", "review.rrd", "report.html"}


def names(folder):
    return {path.name for path in folder.path.iterdir()}


def fails(*arguments, **options):
    raise OSError(28, "No space left on device")


def made(path, **options):
    return ended_run(path, narrow=True, **options)


def test_every_file_is_made_and_the_manifest_says_that_none_is_missing(tmp_path):
    folder, manifest = made(tmp_path / "run")
    said = []
    derived = derive_files(folder, manifest, said.append)
    assert names(folder) == ALL
    assert (derived.missing, derived.exit_code(True), derived.exit_code(False)) == ({}, 0, 1)
    assert folder.read_manifest()["missing"] == {}
    assert said == ["writing record.parquet", "writing review.rrd", "writing report.html"]


@pytest.mark.parametrize(
    ("broken", "lost"),
    [
        ("hil.run.session.derived_files.export_record", "record.parquet"),
        ("hil.review.write_review", "review.rrd"),
        ("hil.report.page.write_report", "report.html"),
    ],
)
def test_a_file_that_fails_leaves_the_others_and_is_made_later(tmp_path, monkeypatch, broken, lost):
    folder, manifest = made(tmp_path / "run")
    said = []
    with monkeypatch.context() as context:
        context.setattr(broken, fails)
        derived = derive_files(folder, manifest, said.append)
    assert names(folder) == ALL - {lost}
    assert folder.read_manifest()["missing"] == derived.missing == {lost: "No space left on device"}
    assert said[-1] == missing_sentence(derived)
    assert f"report {folder.path}` makes them from the journal" in said[-1]
    assert derived.exit_code(True) == 1
    done = CliRunner().invoke(report, [str(folder.path)])
    assert (done.exit_code, names(folder)) == (0, ALL)
    assert folder.read_manifest()["missing"] == {}
    assert folder.read_manifest()["exit_status"] == "done"


def test_a_defect_in_one_file_is_named_as_one_and_leaves_the_others(tmp_path, monkeypatch):
    folder, manifest = made(tmp_path / "run")
    monkeypatch.setattr("hil.review.write_review", lambda *paths: {}["gone"])
    derived = derive_files(folder, manifest, lambda text: None)
    assert derived.missing == {"review.rrd": "KeyError: 'gone'; a defect of hil, please report it"}
    assert names(folder) == ALL - {"review.rrd"}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_the_making_at_once_and_leaves_what_is_made(tmp_path, monkeypatch, number):
    folder, manifest = made(tmp_path / "run")
    before = signal.getsignal(number)
    began = time.monotonic()

    def slow(*paths):
        assert folder.read_manifest()["missing"]["review.rrd"] == "not made yet"  # what a kill would leave
        os.kill(os.getpid(), number)
        time.sleep(30)

    with monkeypatch.context() as context:
        context.setattr("hil.review.write_review", slow)
        said = []
        derived = derive_files(folder, manifest, said.append)
    assert time.monotonic() - began < 20
    assert signal.getsignal(number) == before
    assert names(folder) == {"run.json", "journal.sqlite", "record.parquet"}
    why = f"stopped by {number.name}"
    assert folder.read_manifest()["missing"] == {"review.rrd": why, "report.html": why}
    assert "not made: review.rrd" in said[-1]
    assert derived.exit_code(True) == derived.exit_code(False) == 128 + number
    regenerate_files(folder, False, said.append)
    assert names(folder) == ALL


def test_a_signal_after_the_last_file_changes_no_exit_code(tmp_path):
    folder, manifest = made(tmp_path / "run")
    assert DerivedFiles(folder, {}, signal.SIGTERM).exit_code(True) == 0
    assert derive_files(folder, manifest, lambda text: None).stopped_by is None


def test_nothing_is_made_from_the_journal_of_another_run(tmp_path):
    folder, manifest = made(tmp_path / "run")
    other, its_manifest = made(tmp_path / "other")
    for run, uid in ((folder, manifest["uid"]), (other, its_manifest["uid"])):
        with contextlib.closing(sqlite3.connect(run.journal)) as database, database:
            database.execute("INSERT INTO meta VALUES (?, ?)", (RUN_UID, json.dumps(uid)))
    assert derive_files(other, its_manifest, lambda text: None).missing == {}
    shutil.copyfile(other.journal, folder.journal)
    derived = derive_files(folder, manifest, lambda text: None)
    assert names(folder) == {"run.json", "journal.sqlite"}
    assert all("is the journal of another run" in why for why in derived.missing.values())
    assert derived.exit_code(True) == 1


def test_a_folder_that_was_moved_gets_its_files_where_it_is_now(tmp_path):
    folder, manifest = made(tmp_path / "run")
    said = []
    with folder.owned():
        (tmp_path / "other").mkdir()
        folder.path.rename(tmp_path / "other" / "moved")
        derived = derive_files(folder, manifest, said.append)
    assert derived.folder.path == tmp_path / "other" / "moved"
    assert names(derived.folder) == ALL
    assert f"the run's folder was moved: its files go to {tmp_path}/other/moved" in said


def test_a_folder_whose_place_another_took_is_found_where_it_went(tmp_path):
    folder, manifest = made(tmp_path / "run")
    with folder.owned():
        folder.path.rename(tmp_path / "moved")
        folder.path.mkdir()
        assert names(derive_files(folder, manifest, lambda text: None).folder) == ALL
    assert list(folder.path.iterdir()) == []


@pytest.mark.parametrize("again", [False, True])
def test_a_folder_that_was_deleted_is_said_to_be_and_the_end_is_saved_beside_it(tmp_path, again):
    folder, manifest = made(tmp_path / "runs" / "run")
    with folder.owned():
        shutil.rmtree(folder.path)
        if again:
            folder.path.mkdir()
        with pytest.raises(FolderLostError) as caught:
            derive_files(folder, manifest, lambda text: None)
    said = str(caught.value)
    assert "was deleted; the run done (the profile is over), the rig was left safe" in said
    assert "its samples are lost" in said
    assert len(said.splitlines()) == exit_code(caught.value) == 1
    copy = tmp_path / "runs" / "run.run.json"
    assert f"how it ended stands in {copy}" in said
    assert json.loads(copy.read_text(encoding="utf-8"))["uid"] == manifest["uid"]


def test_a_folder_that_is_deleted_with_its_parent_is_said_to_be(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder, manifest = made(tmp_path / "runs" / "run")
    manifest["safe"] = False
    with folder.owned():
        shutil.rmtree(tmp_path / "runs")
        with pytest.raises(FolderLostError, match=r"was deleted.*the rig was NOT confirmed safe: look at it now"):
            derive_files(folder, manifest, lambda text: None)
    assert [path.name for path in tmp_path.glob("hil-run-*/*")] == ["run.run.json"]


def test_a_folder_that_cannot_be_written_any_more_is_said_to_be(tmp_path, monkeypatch):
    folder, manifest = made(tmp_path / "run")

    def refuses(self, document):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("hil.run_folder.folder.RunFolder.write_manifest", refuses)
    with pytest.raises(FolderLostError) as caught:
        derive_files(folder, manifest, lambda text: None)
    assert "cannot be written (Read-only file system)" in str(caught.value)
    assert "make it writable, then `" in str(caught.value)
    assert (tmp_path / "run.run.json").is_file()


def test_a_run_killed_before_it_could_say_how_it_ended_is_reported_by_its_journal(tmp_path):
    folder, manifest = made(tmp_path / "run")
    folder.write_manifest(manifest | {"exit_status": "running", "reason": ""})
    regenerate_files(folder, False, lambda text: None)
    found = folder.read_manifest()
    assert (found["exit_status"], found["reason"], found["ticks"]) == ("done", "the profile is over", 300)
    assert names(folder) == ALL
    assert "NOT confirmed safe" in folder.report.read_text(encoding="utf-8")  # its journal does not tell


def test_the_journal_keeps_how_a_run_ended_that_was_killed_before_its_manifest(tmp_path):
    folder, manifest = made(tmp_path / "run")
    end = end_entries(folder, manifest, Outcome("done", "the profile is over", 300, safe=True), None, 9.0)
    assert set(end) == set(END_KEYS)
    writer = JournalWriter(folder.journal, narrowed(make(300)).header, again=True)
    errors = ErrorTable(("static",), {"T_tank_C": (0.123,)}, {"T_tank_C": 0.01})
    twins = twin_entries(Comparison(errors, {}, {}, {}))
    assert set(twins) == set(TWIN_KEYS) == set(twin_entries(None))
    writer.put_meta(END_OF_RUN, end | twins | {"uid": "of another"})
    writer.close()
    begun = {key: value for key, value in manifest.items() if key not in END_KEYS}
    folder.write_manifest(begun | {"exit_status": "running", "reason": "", "segments": []})
    regenerate_files(folder, False, lambda text: None)
    found = folder.read_manifest()
    assert left_safe(found) and found["wall_s"] == 9.0 and found["uid"] == manifest["uid"]
    page = folder.report.read_text(encoding="utf-8")
    assert "left at its safe value, read back" in page
    assert "RMSE in K" in page and "0.123" in page


def test_a_test_that_was_killed_during_its_last_diagnosis_is_judged_and_names_the_lack(tmp_path):
    folder, manifest = made(tmp_path / "run")
    plan = tmp_path / "plan.toml"
    plan.write_text(plan_text("no trip"), encoding="utf-8")
    manifest["files"]["test"] = {"path": str(plan), "sha256": file_sha256(plan)}
    manifest["settings"]["diagnose_s"] = "end"
    folder.write_manifest(manifest | {"exit_status": "running", "reason": ""})
    write_review(folder.journal, folder.review)  # as the process of the review does, which outlives the run
    said: list[str] = []
    regenerate_files(folder, False, said.append)
    assert "hil diagnose" in said[0] and "writing review.rrd" not in said
    assert read_verdict(folder)["verdict"] == "pass" and folder.read_manifest()["verdict"] == "pass"
    folder.diagnosis.mkdir()
    write_document(diagnosis().document(), folder.diagnosis)
    write_curves(curves_of(diagnosis(), SENSORS), folder.diagnosis / CURVES)
    said.clear()
    regenerate_files(folder, False, said.append)
    assert said == ["writing review.rrd", "writing report.html"]


def test_a_run_that_was_cut_is_reported_as_far_as_it_came_and_stays_cut(tmp_path):
    folder, manifest = made(tmp_path / "run", ended=False)
    folder.write_manifest(manifest)
    regenerate_files(folder, False, lambda text: None)
    assert names(folder) == ALL
    assert folder.was_cut
    assert pq.read_metadata(folder.record).num_rows == 300


def test_a_live_run_is_not_reported(tmp_path):
    folder, manifest = made(tmp_path / "run", ended=False)
    folder.write_manifest(manifest)
    with folder.owned(), pytest.raises(RunFolderError, match="still goes on"):
        regenerate_files(folder, False, lambda text: None)


def test_an_ended_run_whose_files_another_command_makes_is_not_called_live(tmp_path):
    folder, manifest = made(tmp_path / "run")
    folder.write_manifest(manifest)
    with folder.owned(), pytest.raises(RunFolderError, match="another process makes the files of this run; wait"):
        regenerate_files(folder, False, lambda text: None)


def test_record_and_review_are_made_again_where_they_are_older_or_it_is_asked(tmp_path):
    folder, manifest = made(tmp_path / "run")
    derive_files(folder, manifest, lambda text: None)
    said = []
    regenerate_files(folder, False, said.append)
    assert said == ["writing report.html"]
    os.utime(folder.record, (1e9, 1e9))
    said.clear()
    regenerate_files(folder, False, said.append)
    assert said == ["writing record.parquet", "writing report.html"]
    said.clear()
    regenerate_files(folder, True, said.append)
    assert said == ["writing record.parquet", "writing review.rrd", "writing report.html"]


@pytest.mark.parametrize("exit_status", ["done", "running"])
def test_a_run_that_went_to_its_end_is_not_resumed_and_its_files_are_pointed_at(tmp_path, exit_status):
    folder, manifest = made(tmp_path / "run")
    folder.write_manifest(manifest | {"exit_status": exit_status})
    with pytest.raises(RunFolderError, match=r"has run to its end; `hil report .*` makes its record and report"):
        request_of(folder, folder.read_manifest(), {})


def test_the_record_of_an_ended_run_is_made_for_whoever_reads_it(tmp_path):
    folder, manifest = made(tmp_path / "run")
    folder.write_manifest(manifest)
    folder.twin.touch()
    assert subject_of(folder.path, None).record == folder.record
    assert pq.read_metadata(folder.record).num_rows == 300
    folder.record.unlink()
    folder.journal.write_text("damaged", encoding="utf-8")
    with pytest.raises(SubjectError, match="none can be made from its journal"):
        subject_of(folder.path, None)


def test_a_run_folder_is_checked_and_commissioned_by_its_record(tmp_path):
    folder, manifest = ended_run(tmp_path / "run")
    folder.write_manifest(manifest)
    checked = CliRunner().invoke(check, [str(folder.path)])
    assert checked.exit_code == 0, checked.output
    assert "record.parquet: 300 samples over 0.08 h" in checked.output
    with pytest.raises(SubjectError, match=r"holds no record.parquet; give a run folder"):
        CliRunner().invoke(check, [str(tmp_path)], catch_exceptions=False)
    twin = tmp_path / "twin.toml"
    text = (Path(__file__).resolve().parents[2] / "profiles/twins/loop.toml").read_text(encoding="utf-8")
    twin.write_text(text.replace("pump_speed_pct", "pump_nowhere_pct"), encoding="utf-8")
    with pytest.raises(RecordError) as caught:
        CliRunner().invoke(
            commission,
            [str(folder.path), "--twin", str(twin), "--out", str(tmp_path / "new.toml")],
            catch_exceptions=False,
        )
    assert str(caught.value).startswith(f"{folder.record} lacks pump_nowhere_pct")


def test_a_report_of_an_interrupted_run_says_nothing_of_the_safe_end_before_it(tmp_path):
    folder, manifest = made(tmp_path / "run", ended=False)
    folder.write_manifest(manifest | {"exit_status": "running", "safe": True})
    regenerate_files(folder, False, lambda text: None)
    page = folder.report.read_text(encoding="utf-8")
    assert "<b>interrupted</b>" in page
    assert "NOT confirmed safe" in page
    assert "left at its safe value" not in page


@pytest.mark.parametrize(
    ("entries", "safe"),
    [
        ({"exit_status": "done", "safe": True, "away": ""}, True),
        ({"exit_status": "done", "safe": True, "away": "T_tank_C is 70"}, False),
        ({"exit_status": "faulted", "safe": False}, False),
        ({"exit_status": "running", "safe": True}, None),
        ({"exit_status": "done"}, None),
    ],
)
def test_only_an_ended_run_was_left_safe(entries, safe):
    assert left_safe(entries) is safe
