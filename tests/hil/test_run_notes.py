"""Notes and labels of runs: appended live and later, shown in the report and in the list of runs."""

from __future__ import annotations

import json

import pytest

from hil.report import PdfError, write_pdf, write_report
from hil.run_folder import Labels, RunFolderError, add_note, labels_of, read_notes
from tests.hil.command_line import typed
from tests.hil.ended_run import ended_run


@pytest.fixture
def run(tmp_path):
    folder, manifest = ended_run(tmp_path / "runs" / "20260520T120000Z-load", ticks=60)
    manifest["labels"] = Labels("Pump", "0041", "J. Doe", ("night",)).given()
    manifest["files"] = {name: {"path": f"/x/{name}.toml", "sha256": "0" * 64} for name in ("rig", "profile")}
    folder.write_manifest(manifest)
    return folder


def test_notes_are_appended_also_while_the_run_goes_on(run):
    with run.owned():  # as a live run holds its folder
        add_note(run, "valve\topened\x1b[2J", "J. Doe")
    done = typed("note", run.path, "coolant topped up", "--by", "M. Mustermann")
    assert done.returncode == 0
    notes = read_notes(run)
    assert [(note.by, note.text) for note in notes] == [
        ("J. Doe", "valve\topened [2J"),
        ("M. Mustermann", "coolant topped up"),
    ]


def test_a_later_label_replaces_an_earlier_one_and_leaves_the_others(run):
    add_note(run, "", "J. Doe", Labels(serial_number="0042"))
    add_note(run, "tagged", "J. Doe", Labels(tags=("endurance", "night")))
    labels = labels_of(run.read_manifest(), read_notes(run))
    assert labels == Labels("Pump", "0042", "J. Doe", ("endurance", "night"))


def test_the_report_shows_labels_and_notes_as_text(run):
    add_note(run, "<script>alert(1)</script>", "J. <b>", Labels(test_object="<i>Unit</i>"))
    write_report(run)
    page = run.report.read_text(encoding="utf-8")
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page and page.count("<script>") == 1  # that of the plots
    assert "&lt;i&gt;Unit&lt;/i&gt;" in page and "0041" in page and "night" in page


def test_an_empty_note_and_a_folder_without_a_run_are_refused(run, tmp_path):
    assert "the note is empty" in typed("note", run.path, "  ").stderr
    done = typed("note", tmp_path, "hello")
    assert done.returncode == 2 and "is not a run folder" in done.stderr
    assert not (tmp_path / "notes.jsonl").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("x" * 2001,), "the note has 2001 characters, at most 2000 are kept"),
        (("hello", "--by", "y" * 201), "the name of the author has 201 characters"),
        (("hello", "--tag", "z" * 201), "it has 201 characters"),
        (("hello", "--tag", ""), "it is empty"),
        (("hello", "--serial", "  "), "it is empty"),
        (("hello", "--object", ""), "it is empty"),
    ],
)
def test_a_note_that_is_not_kept_whole_is_refused(run, arguments, said):
    done = typed("note", run.path, *arguments)
    assert done.returncode == 2 and said in done.stderr and not read_notes(run)
    assert typed("note", run.path, "x" * 2000).returncode == 0 and read_notes(run)[0].text == "x" * 2000


def test_a_list_without_runs_states_why(run, tmp_path):
    assert f"is a run itself; give its parent, {run.path.parent}" in typed("ls", run.path).stderr
    assert "no run in" in typed("ls", run.path.parent, "--tag", "none").stderr
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no run folder" in typed("ls", empty).stderr


def test_notes_are_written_into_no_other_file(run, tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("mine", encoding="utf-8")
    run.notes.symlink_to(victim)
    with pytest.raises(RunFolderError):
        add_note(run, "hello", "J. Doe")
    assert victim.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    "line",
    ["{", "[]", "5", '{"time": "yesterday"}', '{"time": 5}', '{"time": "2026-01-01T00:00:00", "text": {}}', "\xff"],
)
def test_a_damaged_line_is_named(run, line):
    add_note(run, "good", "J. Doe")
    with run.notes.open("ab") as file:
        file.write(line.encode("latin-1") + b"\n")
    with pytest.raises(RunFolderError, match=r"line 2 is not a note.*take the line out"):
        read_notes(run)


def test_a_last_line_that_a_crash_cut_is_left_out_and_the_next_note_is_whole(run):
    add_note(run, "good", "J. Doe")
    with run.notes.open("ab") as file:
        file.write(b'{"time": "2026-')
    assert [note.text for note in read_notes(run)] == ["good"]
    add_note(run, "after", "J. Doe")
    assert [note.text for note in read_notes(run)] == ["good", "after"]
    assert run.notes.read_bytes().splitlines()[-1].endswith(b'"labels": {}}')


def test_runs_are_listed_with_verdict_end_rig_duration_and_tags(run):
    other, manifest = ended_run(run.path.with_name("20260521T120000Z-load"), ticks=60, ended=False)
    other.write_manifest(manifest | {"started": "2999-01-01T00:00:00+00:00"})
    damaged = run.path.with_name("damaged")
    damaged.mkdir()
    (damaged / "run.json").write_text("{", encoding="utf-8")
    limit = dict.fromkeys(("id", "limit", "requirement", "severity", "unit", "text"), "x")
    limit |= {"step": None, "verdict": "fail", "value": None, "at_s": None}
    test = {"id": "p", "title": "", "sha256": "", "judged": "", "verdict": "fail", "limits": [limit]}
    run.verdict.write_text(json.dumps({"verdict": "fail", "tests": [test]}), encoding="utf-8")
    done = typed("ls", run.path.parent, "--json")
    assert done.returncode == 0
    items = {item["folder"].rpartition("/")[2]: item for item in json.loads(done.stdout)}
    first = items[run.path.name]
    shown = [first[key] for key in ("verdict", "exit_status", "rig", "profile", "duration_s", "serial_number", "tags")]
    assert shown == ["fail", "done", "rig", "profile", 60.0, "0041", ["night"]]
    assert items[other.path.name]["exit_status"] == "interrupted"
    assert "run.json is damaged" in items["damaged"]["problem"]
    table = typed("ls", run.path.parent)
    assert table.returncode == 0 and "night" in table.stdout and "is damaged" in table.stderr
    assert json.loads(typed("ls", run.path.parent, "--tag", "day", "--json").stdout) == []
    assert len(json.loads(typed("ls", run.path.parent, "--verdict", "fail", "--json").stdout)) == 1


def test_a_folder_that_is_not_there_is_named(tmp_path):
    done = typed("ls", tmp_path / "none")
    assert done.returncode == 2 and "name the parent of the runs" in done.stderr


def test_without_a_browser_a_pdf_is_refused_with_the_remedy(run, monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    run.report.write_text("<p>a report</p>", encoding="utf-8")
    with pytest.raises(PdfError, match="install one, or open"):
        write_pdf(run.report, run.path / "report.pdf")
    assert not (run.path / "report.pdf").exists()


def test_a_browser_that_prints_nothing_is_reported(run, tmp_path, monkeypatch):
    browser = tmp_path / "chromium"
    browser.write_text("#!/bin/sh\necho no display >&2\nexit 7\n", encoding="utf-8")
    browser.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    run.report.write_text("<p>a report</p>", encoding="utf-8")
    with pytest.raises(PdfError, match="no display"):
        write_pdf(run.report, run.path / "report.pdf")
    browser.write_text(
        '#!/bin/sh\nfor a in "$@"; do case "$a" in --print-to-pdf=*) echo PDF > "${a#*=}";; esac; done\n'
    )
    write_pdf(run.report, run.path / "report.pdf")
    assert (run.path / "report.pdf").read_text() == "PDF\n"
