"""A journal that a disk or a person has damaged: a sentence that names the file and the part, not a traceback."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from hil.bench.fuzz.journal import read_all, sound_journal
from hil.journal.writer import JournalError, JournalReader


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    path = tmp_path / "journal.sqlite"
    sound_journal(path)
    return path


def changed(path: Path, *statements: str) -> None:
    database = sqlite3.connect(path, isolation_level=None)
    for statement in statements:
        database.execute(statement)
    database.close()


def test_a_sound_journal_is_read_by_every_method(journal, monkeypatch):
    methods = {name for name, value in vars(JournalReader).items() if callable(value) and not name.startswith("_")}
    found: dict[str, object] = {}

    def kept(name, read):
        def called(reader, *arguments):
            found[name] = read(reader, *arguments)
            return found[name]

        return called

    for name in methods:
        monkeypatch.setattr(JournalReader, name, kept(name, getattr(JournalReader, name)))
    read_all(journal)
    assert set(found) == methods
    tables = ("calibrations", "proposals", "bands", "writes", "events", "states", "segments")
    assert {name: len(found[name]) for name in tables} == dict.fromkeys(tables, 1)
    assert (found["sample_count"], found["last"], found["tick_at"]) == (5, (4, 1e9 + 4), 4)


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("UPDATE meta SET value = '{' WHERE key = 'header'", "its header cannot be read"),
        ("UPDATE meta SET value = '3' WHERE key = 'header'", "its header cannot be read"),
        ("UPDATE meta SET value = 'x' WHERE key = 'schema_version'", "its header cannot be read"),
        ("UPDATE samples SET quality = x'00'", "its samples cannot be read"),
        ("UPDATE samples SET source_time_s = 'text'", "its samples cannot be read"),
        ("UPDATE calibrations SET document = '['", "its calibrations cannot be read"),
        ("ALTER TABLE states DROP COLUMN reason", "its states cannot be read"),
        ("DROP TABLE events", "its events cannot be read (no such table: events)"),
    ],
)
def test_damage_is_named_with_the_file_and_the_part(journal, statement, said):
    changed(journal, statement)
    with pytest.raises(JournalError) as caught:
        read_all(journal)
    assert str(caught.value).startswith(f"{journal} is damaged: ")
    assert said in str(caught.value)
    assert "argument" not in str(caught.value)


def test_another_version_and_another_file_are_refused(journal, tmp_path):
    changed(journal, "UPDATE meta SET value = '99' WHERE key = 'schema_version'")
    with pytest.raises(JournalError, match="has schema 99, this version reads"):
        JournalReader(journal)
    other = tmp_path / "other.sqlite"
    other.write_bytes(b"no database " * 100)
    with pytest.raises(JournalError, match="is not a journal of this harness"):
        JournalReader(other)
