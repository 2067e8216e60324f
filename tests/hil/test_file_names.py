"""Paths with any legal character: journals, records, reviews, reports and the names of run folders."""

from __future__ import annotations

import io
import os
import sqlite3
import sys

import pytest

from hil.files.atomic import replacing
from hil.files.names import (
    LONGEST_DATABASE_PATH,
    accept_any_name,
    connect_read_only,
    printable,
    safe_file_name,
    utf8_path,
)
from hil.journal.writer import JournalError, JournalReader
from hil.profile.load_profile import read_profile
from hil.record.reader import read_record, write_record
from hil.review.rerun_io import read_columns
from hil.run.session.derived_files import derive_files
from hil.run_folder.folder import RunFolderError, create_run_folder
from hil.run_folder.room import RunSize
from tests.hil.ended_run import ended_run

NAMES = [
    b"hash#1",
    b"quest?ion",
    b"pct%41",
    b"q?mode=rwc&cache=shared",
    b"with space \xc3\xbc",
    b"quo\"te'`$(x)",
    b"two\nlines",
    b"no utf-8 \xff\xfe",
    b"--option",
    b"-",
    b"dots...",
    b"<b>&amp;",
    b"[red]markup[",
    b"back\\slash",
    b"file:x",
    b"\x1b[31mescape",
    "\N{FIRE}\N{COMBINING ACUTE ACCENT}".encode() * 30,
    b"x" * 220,
    b" ",
]
NESTED = [b"/".join(NAMES[first : first + 4]) for first in range(0, 16, 4)] + [
    b"/".join(NAMES[k : k + 1] + NAMES[-1:]) for k in (16, 17)
]
"""All names as parts of few paths, since the files of a run take seconds."""


@pytest.mark.parametrize("names", NESTED)
def test_a_run_in_a_folder_of_any_name_gets_all_its_files(tmp_path, names):
    (tmp_path / os.fsdecode(names)).parent.mkdir(parents=True)
    folder, manifest = ended_run(tmp_path / os.fsdecode(names), ticks=120, narrow=True)
    manifest["files"] = {"profile": {"path": str(folder.path / "load.csv"), "sha256": "0" * 64}}
    assert derive_files(folder, manifest, lambda text: None).missing == {}
    assert folder.read_manifest()["files"] == manifest["files"]
    assert len(read_record(folder.record).time_s) == 120
    write_record(read_record(folder.record), folder.path / "again.parquet")
    assert len(read_columns(folder.review, "/sensors/T_tank_C/measured")[0]) == 120
    assert folder.report.read_text(encoding="utf-8").startswith("<!doctype html>")
    with connect_read_only(folder.journal) as database, pytest.raises(sqlite3.OperationalError, match="readonly"):
        database.execute("DELETE FROM samples")


@pytest.mark.parametrize("name", NAMES)
def test_a_run_folder_is_named_by_any_profile(tmp_path, name):
    path = tmp_path / (os.fsdecode(name[:250]) + ".csv")
    path.write_text("time_s,heater_power_W\n0,300\n700,300\n", encoding="utf-8")
    profile = read_profile(path)
    made = create_run_folder(tmp_path / "runs", profile.name, RunSize(1)).path
    assert len(os.fsencode(made.name)) < 255 - len(".run.json")
    assert made.name.isprintable()
    printable(made.name).encode()
    assert safe_file_name(path.stem)[:150] in made.name


def test_a_name_is_cut_between_characters():
    assert safe_file_name("a" + "\N{FIRE}" * 3, 8) == "a\N{FIRE}"


def test_folders_of_one_second_are_told_apart(tmp_path):
    made = {create_run_folder(tmp_path, "load", RunSize(1)).path for _ in range(5)}
    assert len(made) == 5


def test_a_path_that_sqlite_cannot_take_is_refused_before_the_run_and_a_shorter_name_is_tried(tmp_path):
    deep = tmp_path
    while len(os.fsencode(deep)) < LONGEST_DATABASE_PATH - 120:
        deep /= "d" * 40
    made = create_run_folder(deep, "p" * 200, RunSize(1))
    assert len(os.fsencode(made.journal)) <= LONGEST_DATABASE_PATH
    database = sqlite3.connect(made.journal)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("CREATE TABLE a (b)")
    database.close()
    connect_read_only(made.journal).execute("SELECT * FROM a").close()
    with pytest.raises(
        RunFolderError, match=r"is too long: SQLite takes 504 bytes .* choose a shorter folder with --runs"
    ):
        create_run_folder(deep / ("e" * 100), "p", RunSize(1))


def test_a_journal_that_was_moved_too_deep_says_so(tmp_path):
    folder, _ = ended_run(tmp_path / "run", ticks=5)
    deep = tmp_path / ("d" * 240) / ("e" * 240)
    deep.parent.mkdir()
    folder.path.rename(deep)
    with pytest.raises(JournalError, match="SQLite takes 504 bytes for a path; move the run's folder to a shorter one"):
        JournalReader(deep / "journal.sqlite")


@pytest.mark.parametrize("kind", ["file", "dangling link", "under a file"])
def test_a_place_that_can_be_no_folder_is_refused_with_the_option_to_change(tmp_path, kind):
    place = tmp_path / "runs"
    if kind == "dangling link":
        place.symlink_to(tmp_path / "nowhere")
    else:
        place.touch()
    with pytest.raises(RunFolderError, match=r"cannot be made .* choose another folder with --runs"):
        create_run_folder(place / "below" if kind == "under a file" else place, "load", RunSize(1))
    assert not (tmp_path / "nowhere").exists()


def test_a_link_to_a_folder_is_a_place_for_runs(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "runs").symlink_to(tmp_path / "disk")
    assert create_run_folder(tmp_path / "runs", "load", RunSize(1)).path.is_dir()


def test_a_place_that_takes_no_folder_is_refused(tmp_path, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.mkdir", full)
    with pytest.raises(RunFolderError, match="cannot be made \\(No space left on device\\); choose another folder"):
        create_run_folder(tmp_path / "runs", "load", RunSize(1))


def test_a_path_by_way_of_the_open_folder_is_the_same_file(tmp_path):
    folder = tmp_path / os.fsdecode(b"bad \xff")
    folder.mkdir()
    with utf8_path(folder / "a.txt") as path:
        str(path).encode()
        path.write_text("hello", encoding="utf-8")
    assert (folder / "a.txt").read_text(encoding="utf-8") == "hello"
    with utf8_path(tmp_path / "b") as path:
        assert path == tmp_path / "b"


def test_a_file_with_the_longest_name_is_replaced_whole(tmp_path):
    for name in ("n" * 255, "\N{FIRE}" * 63):
        with replacing(tmp_path / name) as unfinished:
            unfinished.write_text("whole", encoding="utf-8")
        assert (tmp_path / name).read_text(encoding="utf-8") == "whole"


def test_outputs_take_every_name_and_give_its_bytes_back(monkeypatch):
    raw = io.BytesIO()
    for stream in ("stdout", "stderr"):
        monkeypatch.setattr(sys, stream, io.TextIOWrapper(raw, encoding="ascii", write_through=True))
    accept_any_name()
    print(os.fsdecode(b"bad \xff"), "\ud800", "\N{FIRE}")
    assert raw.getvalue() == b"bad \xff \\ud800 \\U0001f525\n"
