"""Files that a command is asked to write: none of them is a file of a run, or one that the command reads."""

from __future__ import annotations

import os

import pytest

from hil.run_folder import RunFolderError, require_output
from tests.docs.fences import PROJECT
from tests.hil.command_line import typed
from tests.hil.ended_run import ended_run

OWN = (
    "journal.sqlite",
    "journal.sqlite-wal",
    "record.parquet",
    "review.rrd",
    "twin.toml",
    "twin.before-1.toml",
    "virtual.healthy.parquet",
    "report.html",
    "report.pdf",
    "run.json",
    "notes.jsonl",
    "verdict.json",
    "junit.xml",
    "guardian.log",
    "stream-mqtt-x.json",
    "diagnosis/diagnosis.json",
    "explanation/anything",
)


@pytest.fixture
def run(tmp_path):
    folder, manifest = ended_run(tmp_path / "run", ticks=60)
    folder.write_manifest(manifest)
    for name in ("diagnosis", "explanation"):
        (folder.path / name).mkdir()
    return folder


@pytest.mark.parametrize("name", OWN)
def test_a_file_of_a_run_is_refused_also_through_a_link_and_before_it_is_there(run, tmp_path, name):
    target = run.path / name
    with pytest.raises(RunFolderError, match="is a file of the run"):
        require_output(target, RunFolderError)
    link = tmp_path / "link.html"
    link.symlink_to(target)
    with pytest.raises(RunFolderError, match="is a file of the run"):
        require_output(link, RunFolderError)


def test_another_file_in_or_beside_a_run_is_accepted(run, tmp_path):
    require_output(run.path / "temperatures.csv", RunFolderError)
    require_output(tmp_path / "report.html", RunFolderError)  # no run here


def test_a_source_is_refused_by_each_of_its_names(tmp_path):
    source = tmp_path / "source.toml"
    source.write_text("x", encoding="utf-8")
    other = tmp_path / "other.toml"
    os.link(source, other)
    for path in (source, other):
        with pytest.raises(RunFolderError, match="this command reads"):
            require_output(path, RunFolderError, [source])


def test_pictures_and_predictions_replace_no_file_of_a_run(run):
    twin, before = PROJECT / "profiles/twins/virtual.toml", run.journal.read_bytes()
    for words in (
        ("review", run.path, "--screenshot", run.journal),
        ("track", run.path, "--twin", twin, "--out", run.diagnosis / "out.csv"),
        ("check", twin, "--picture", run.path / "report.pdf"),
    ):
        done = typed(*words)
        assert done.returncode == 2 and "is a file of the run" in done.stderr, done.stderr
    assert run.journal.read_bytes() == before
    done = typed("check", twin, "--picture", run.path / "x.abc")
    assert done.returncode == 2 and "a picture is a .svg" in done.stderr and "Traceback" not in done.stderr
