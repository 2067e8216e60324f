"""A run folder from somebody else: review, report and resume do nothing outside it, run nothing, and say why not."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drivers.rig_file.reader import file_sha256
from hil.files.html import joined
from hil.journal.writer import JournalError, JournalReader
from hil.report.page import write_report
from hil.run.engine.control_socket import ControlError, ask
from hil.run.session.interrupted_run import position_of, request_of, resume_notices
from hil.run.session.regenerate import regenerate_files
from hil.run.session.request import RunRequest
from hil.run_folder.folder import RunFolder, RunFolderError, new_manifest
from tests.hil.synthetic_journal import make, write

PROJECT = Path(__file__).resolve().parents[2]
HIL = [sys.executable, "-m", "hil"]
RIG = PROJECT / "profiles" / "rigs" / "virtual.toml"
LOAD = PROJECT / "profiles" / "loads" / "battle_10h.csv"
SETTINGS = {
    "virtual": True,
    "mode": "lockstep",
    "speed": 1.0,
    "seed": 0,
    "calibrators": [],
    "network_mode": "shadow",
}


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = RunFolder(tmp_path_factory.mktemp("original"))
    write(folder.journal, make(200))
    manifest = new_manifest({"rig": RIG, "profile": LOAD}, **SETTINGS)
    folder.write_manifest(manifest | {"exit_status": "aborted", "reason": "by an operator"})
    return folder.path


@pytest.fixture
def run(original: Path, tmp_path: Path) -> RunFolder:
    shutil.copytree(original, tmp_path / "run")
    return RunFolder(tmp_path / "run")


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the pictures out of reports: they are of samples that have been read, and take a second each time."""
    monkeypatch.setattr("hil.report.page.pictures", lambda drawn: joined([]))


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "outside" / "secret.txt"
    path.parent.mkdir()
    path.write_text("hunter2", encoding="utf-8")
    return path


def altered(run: RunFolder, **entries: Any) -> dict[str, Any]:
    document = json.loads(run.manifest.read_text(encoding="utf-8")) | entries
    run.manifest.write_text(json.dumps(document), encoding="utf-8")
    return document


def hil(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*HIL, *map(str, arguments)], capture_output=True, text=True, cwd=PROJECT, timeout=120)


def test_what_is_in_order_is_read_and_reported(run: RunFolder) -> None:
    assert run.read_manifest()["reason"] == "by an operator"
    write_report(run)
    assert "by an operator" in run.report.read_text(encoding="utf-8")


def test_a_folder_with_everything_that_a_run_may_write_is_in_order(run: RunFolder) -> None:
    for name in ("guardian.log", "record.healthy.parquet", "twin.toml", "twin.before-1.toml", "journal.sqlite-shm"):
        (run.path / name).write_bytes(b"x")
    run.diagnosis.mkdir()
    (run.diagnosis / "diagnosis.json").write_text("{}", encoding="utf-8")
    outcome = {
        "exit_status": "done with deviations",
        "deviations": ["pump asked for 80 % in the mean"],
        "trips": ["T high"],
        "away": "",
        "guardian": "the run hung; safe values read back",
        "missing": {"review.rrd": "no space"},
        "errors_K": {"columns": ["static"], "rows": {"T_C": [None]}, "noise_K": {"T_C": None}},
        "bands": {"static": {"T_C": [None, None]}},
        "diagnosis": None,
        "adoption": None,
    }
    altered(run, **outcome)
    assert run.read_manifest()["exit_status"] == "done with deviations"
    write_report(run)
    assert "done with deviations" in run.report.read_text(encoding="utf-8")


NAMES = ("record.parquet", "review.rrd", "report.html", "twin.toml", "journal.sqlite-wal", "control.sock", "diagnosis")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["file", "nothing", "folder"])
def test_a_link_in_the_folder_is_refused_wherever_it_leads(run: RunFolder, secret: Path, name: str, kind: str) -> None:
    target = {"file": secret, "nothing": secret.parent / "new", "folder": secret.parent}[kind]
    (run.path / name).symlink_to(target)
    for use in (lambda: write_report(run), run.read_manifest):
        with pytest.raises(RunFolderError, match=f"{name} is a link to '.*take the link away"):
            use()
    assert sorted(path.name for path in secret.parent.iterdir()) == ["secret.txt"]
    assert secret.read_text(encoding="utf-8") == "hunter2"


def test_a_link_deep_in_the_diagnosis_is_refused(run: RunFolder, secret: Path) -> None:
    (run.diagnosis / "more").mkdir(parents=True)
    (run.diagnosis / "more" / "diagnosis.json").symlink_to(secret)
    with pytest.raises(RunFolderError, match="is a link to"):
        run.read_manifest()


@pytest.mark.parametrize("name", ["run.json", "twin.toml"])
def test_a_pipe_does_not_hold_a_reader(run: RunFolder, name: str) -> None:
    (run.path / name).unlink(missing_ok=True)
    os.mkfifo(run.path / name)
    with pytest.raises(RunFolderError, match=f"{name} is no plain file.*take it away"):
        run.read_manifest()


def test_the_control_socket_of_a_live_run_is_in_order(run: RunFolder) -> None:
    before = run.read_manifest()
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(f"/proc/self/fd/{(folder := os.open(run.path, os.O_RDONLY))}/control.sock")
        os.close(folder)
        assert (run.path / "control.sock").is_socket()
        assert run.read_manifest() == before


WRONG: dict[str, Any] = {
    "exit_status": {"a": 1},
    "reason": ["x"],
    "uid": 7,
    "files": ["rig"],
    "versions": {"hil": 1},
    "problems": "all",
    "segments": [{"number": "two"}],
    "errors_K": {"columns": 1},
    "bands": {"static": {"T": [1.0]}},
    "parameters": {"pso": {"a": ["x", None, True]}},
    "adoption": "yes",
    "overruns": "many",
    "host": None,
    "settings": {"control": ["host", "port"]},
    "missing": ["review.rrd"],
    "deviations": "none",
    "guardian": {},
}


@pytest.mark.parametrize("key", WRONG)
def test_an_entry_of_another_kind_is_one_sentence(run: RunFolder, key: str) -> None:
    altered(run, **{key: WRONG[key]})
    with pytest.raises(RunFolderError, match=rf"run\.json is not what a run writes: '{key}"):
        write_report(run)


def test_a_wrong_entry_is_quoted_in_plain_words_and_briefly(run: RunFolder) -> None:
    altered(run, reason=["\x1b[2J" * 1000])
    with pytest.raises(RunFolderError) as caught:
        run.read_manifest()
    said = str(caught.value)
    assert "'reason' cannot be [" in said and said.isprintable() and len(said) < 300 + len(str(run.manifest))


@pytest.mark.parametrize(
    "text", ["", "{", "[" * 100_000, "[]", "null", '{"exit_status": ' + "9" * 5000 + "}", "\udcff", '{"reason": ""}']
)
def test_what_is_no_manifest_is_one_sentence(run: RunFolder, text: str) -> None:
    run.manifest.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(RunFolderError, match="the journal beside it still holds the run"):
        run.read_manifest()


def test_a_manifest_of_gigabytes_is_not_read(run: RunFolder) -> None:
    with run.manifest.open("wb") as file:
        file.truncate(10**11)
    with pytest.raises(RunFolderError, match="has 100000 MB, and at most 64 MB are read"):
        run.read_manifest()


FORGED = {
    "a view in place of a table": "ALTER TABLE events RENAME TO e; CREATE VIEW events AS SELECT * FROM e",
    "a view without an end": "CREATE VIEW v AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) "
    "SELECT x FROM c",
    "a trigger": "CREATE TRIGGER t AFTER INSERT ON events BEGIN DELETE FROM samples; END",
    "a virtual table": "CREATE VIRTUAL TABLE v USING fts5(a)",
    "a computed column": "CREATE TABLE g (a, b GENERATED ALWAYS AS (hex(zeroblob(1000000000))))",
    "an index that computes": "CREATE INDEX i ON events (hex(text))",
}


@pytest.mark.parametrize("statement", FORGED.values(), ids=FORGED.keys())
def test_a_journal_with_more_than_tables_is_refused(run: RunFolder, statement: str) -> None:
    database = sqlite3.connect(run.journal)
    database.executescript(statement)
    database.close()
    with pytest.raises(JournalError, match="which no journal of this harness has"):
        JournalReader(run.journal)


CELLS = {
    "a level that is a blob": "UPDATE events SET level = x'00ff'",
    "a time that is a text": "UPDATE events SET time_s = 'x'",
    "a document that is a list": "UPDATE calibrations SET document = '[]'",
    "a document that is no JSON": "UPDATE calibrations SET document = '{'",
    "a document too deep": f"UPDATE calibrations SET document = '{'[' * 50_000}'",
    "a quality of another length": "UPDATE samples SET quality = x'00'",
    "a value that is a text": "UPDATE samples SET heater_power_W = 'hot' WHERE tick = 7",
    "no such table": "DROP TABLE events",
    "fewer columns": "ALTER TABLE events DROP COLUMN level",
}


@pytest.mark.parametrize("statement", CELLS.values(), ids=CELLS.keys())
@pytest.mark.usefixtures("no_pictures")
def test_a_journal_with_cells_of_another_kind_is_one_sentence(run: RunFolder, statement: str) -> None:
    database = sqlite3.connect(run.journal)
    database.executescript(statement)
    database.close()
    with pytest.raises(
        JournalError,
        match=r"journal\.sqlite is damaged: its \w+ cannot be read \(.*\); take the journal from the machine",
    ):
        write_report(run)


def test_a_state_that_no_run_has_is_one_sentence(run: RunFolder) -> None:
    database = sqlite3.connect(run.journal)
    database.execute("INSERT INTO states VALUES (1, 0, 0.0, 0.0, 0.0, 'idle', 'start', 'flying', '')")
    database.commit()
    database.close()
    altered(run, exit_status="running")
    for use in (lambda: regenerate_files(run, False, print), lambda: position_of(run)):
        with pytest.raises(JournalError, match="its states cannot be read \\('flying' is no state of a run"):
            use()


DOCUMENTS = [
    '{"parameters": "x"}',
    '{"parameters": {"a": "x"}}',
    '{"standard_errors": 7}',
    '{"kind": [1]}',
    '{"rmse_K": "a"}',
    '{"mean_K": 1}',
    '{"values": {"a": "x"}, "held": [], "reasons": 3}',
]


@pytest.mark.parametrize("table", ["calibrations", "proposals", "bands"])
@pytest.mark.usefixtures("no_pictures")
def test_a_document_of_another_shape_is_one_sentence(run: RunFolder, table: str) -> None:
    from hil.review import write_review

    for document in DOCUMENTS:
        database = sqlite3.connect(run.journal)
        database.execute(f"UPDATE {table} SET document = ?", (document,))
        database.commit()
        database.close()
        for use in (lambda: write_report(run), lambda: write_review(run.journal, run.review)):
            try:
                use()
            except JournalError as error:
                assert "is damaged: its " in str(error) and "\n" not in str(error)


HEADERS: dict[str, Any] = {
    "twin_sensors": {"T": ["no_such_C"]},
    "signals": "x",
    "twin_names": [1],
    "period_s": 0.0,
    "duration_s": "x",
    "noise_K": {"T": "x"},
    "profile": 1,
}


@pytest.mark.parametrize("key", HEADERS)
def test_a_header_that_does_not_fit_together_is_one_sentence(run: RunFolder, key: str) -> None:
    database = sqlite3.connect(run.journal)
    header = json.loads(database.execute("SELECT value FROM meta WHERE key = 'header'").fetchone()[0])
    database.execute("UPDATE meta SET value = ? WHERE key = 'header'", (json.dumps(header | {key: HEADERS[key]}),))
    database.commit()
    database.close()
    with pytest.raises(JournalError, match=r"journal\.sqlite is damaged"):
        JournalReader(run.journal)


def test_a_damaged_page_is_one_sentence(run: RunFolder) -> None:
    content = bytearray(run.journal.read_bytes())
    content[4096 : len(content)] = b"\xff" * (len(content) - 4096)
    run.journal.write_bytes(content)
    with pytest.raises(JournalError, match="journal"):
        write_report(run)


# --- resume -------------------------------------------------------------------------------------------------------


def request(run: RunFolder, **moved: Path) -> RunRequest:
    return request_of(run, run.read_manifest(), moved)


def test_a_run_in_order_can_be_resumed_and_names_the_rig(run: RunFolder) -> None:
    (sentence,) = resume_notices(request(run))
    assert str(RIG) in sentence and str(LOAD) in sentence and "virtual rig of its own" in sentence
    altered(run, settings=SETTINGS | {"virtual": False})
    (sentence,) = resume_notices(request(run))
    assert "127.0.0.1" in sentence and str(RIG) in sentence


def test_a_rig_file_that_came_with_the_folder_is_not_driven(run: RunFolder) -> None:
    own = run.path / "rig.toml"
    shutil.copy(RIG, own)
    files = json.loads(run.manifest.read_text(encoding="utf-8"))["files"]
    altered(run, files=files | {"rig": {"path": str(own), "sha256": file_sha256(own)}})
    with pytest.raises(RunFolderError, match=r"rig\.toml as the run's rig, which came with .* name it with --rig"):
        request(run)
    assert request(run, rig=own).rig == own
    files["rig"]["path"] = str(run.path / ".." / "run" / "rig.toml")
    altered(run, files=files)
    with pytest.raises(RunFolderError, match="came with the run's own folder"):
        request(run)


@pytest.mark.parametrize("path", ["profiles/rigs/virtual.toml", "", "../rig.toml", "/a\0b"])
def test_a_path_that_is_not_absolute_is_not_followed(run: RunFolder, path: str) -> None:
    files = json.loads(run.manifest.read_text(encoding="utf-8"))["files"]
    altered(run, files=files | {"rig": {"path": path, "sha256": file_sha256(RIG)}})
    with pytest.raises(RunFolderError, match="is no absolute path"):
        request(run)


def test_a_file_that_is_not_what_it_was_is_refused(run: RunFolder) -> None:
    files = json.loads(run.manifest.read_text(encoding="utf-8"))["files"]
    altered(run, files=files | {"rig": {"path": str(RIG), "sha256": "0" * 64}})
    with pytest.raises(RunFolderError, match="is not what it was when the run began"):
        request(run)


@pytest.mark.parametrize("entries", [{"settings": {}}, {"files": {}}])
def test_a_manifest_without_what_a_run_needs_is_one_sentence(run: RunFolder, entries: dict[str, Any]) -> None:
    altered(run, **entries)
    with pytest.raises(RunFolderError, match="cannot be resumed; start a new run"):
        request(run)


def test_a_file_with_a_second_name_elsewhere_is_not_written_on(run: RunFolder, tmp_path: Path) -> None:
    os.link(run.journal, tmp_path / "elsewhere.sqlite")
    run.read_manifest()  # to look at it is in order
    with pytest.raises(RunFolderError, match=r"journal\.sqlite has 2 names \(hard links\).*replace it by a copy"):
        request(run)


def test_a_rollback_journal_that_names_a_further_file_is_refused(run: RunFolder, secret: Path) -> None:
    name = str(secret).encode()
    tail = b"\0\0\0\1" + name + len(name).to_bytes(4, "big") + sum(name).to_bytes(4, "big")
    magic = bytes.fromhex("d9d505f920a163d7")
    run.journal.with_name("journal.sqlite-journal").write_bytes(magic + bytes(504) + tail + magic)
    with pytest.raises(JournalError, match="names another file that SQLite would delete"):
        request(run)
    assert secret.is_file()


@pytest.mark.parametrize("verb", ["review", "resume"])
def test_the_command_line_refuses_with_one_sentence_and_leaves_everything(
    run: RunFolder, secret: Path, verb: str
) -> None:
    (run.path / "review.rrd").symlink_to(secret)
    done = hil(verb, run.path)
    assert done.returncode == 2
    assert "is a link to" in done.stderr and "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert secret.read_text(encoding="utf-8") == "hunter2"


def test_a_control_socket_that_is_a_link_is_not_asked(run: RunFolder, tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "o.sock"))
        listener.listen()
        run.control.symlink_to(tmp_path / "o.sock")
        with pytest.raises(ControlError, match="is a link"):
            ask(run.control, "abort")
