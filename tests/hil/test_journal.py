"""The journal: appending never waits, a bad row takes no other along, a lost file is noticed within a second."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import time

import pytest

from drivers.signals.points import Signal
from hil.journal.store import JournalStore
from hil.journal.writer import Header, JournalError, JournalReader, JournalWriter
from tests.hil.ended_run import wait_until

HEADER = Header((Signal("T_tank", "degC"),), {}, (), "load", 10.0, 0.1, {})


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.sqlite"


def sample(journal: JournalWriter, tick: int, value: float = 20.0) -> None:
    journal.sample(tick, 0.1 * tick, 0.0, 0.0, [value], [0], [0.1 * tick])


def read(path) -> tuple[list[int], list[str]]:
    reader = JournalReader(path)
    found = reader.samples().tick.tolist(), [row.text for row in reader.events()]
    reader.close()
    return found


def test_another_programs_lock_delays_no_append_and_loses_no_row(path):
    journal = JournalWriter(path, HEADER)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    slowest = 0.0
    for tick in range(30):
        began = time.monotonic()
        sample(journal, tick)
        journal.event(tick, 0.1 * tick, "INFO", f"event {tick}")
        journal.check()
        slowest = max(slowest, time.monotonic() - began)
        time.sleep(0.05)
    assert slowest < 0.05
    assert journal.behind_s > 0.5
    assert journal.backlog == 60
    assert read(path)[0] == []
    other.execute("ROLLBACK")
    other.close()
    journal.commit()
    assert journal.behind_s == 0.0
    assert read(path)[0] == list(range(30))
    journal.close()


def test_a_lock_that_stays_is_a_failure_that_names_the_file(path, monkeypatch):
    monkeypatch.setattr("hil.journal.writer.LOCKED_AT_MOST_S", 0.3)
    journal = JournalWriter(path, HEADER)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    sample(journal, 0)
    with pytest.raises(JournalError, match="has been held by another program"):
        journal.commit()
    with pytest.raises(JournalError, match=r"journal\.sqlite"):
        journal.check()
    other.execute("ROLLBACK")
    other.close()
    wait_until(lambda: journal.failure is None)  # the other has let go, and nothing was lost
    journal.check()
    journal.close()
    assert read(path)[0] == [0]


def test_a_row_that_no_database_can_hold_is_dropped_with_its_reason_and_takes_no_other_along(path):
    journal = JournalWriter(path, HEADER)
    sample(journal, 0)
    journal.sample(2**70, 0.1, 0.0, 0.0, [20.0], [0], [0.1])
    journal.write(1, 0.1, "heater\udcff", 5.0, "profile")
    sample(journal, 1)
    sample(journal, 1)  # a tick comes once
    sample(journal, 2)
    journal.commit()
    ticks, events = read(path)
    assert ticks == [0, 1, 2]
    assert len(events) == 3
    assert all("could not be journaled" in text and "is left out" in text for text in events)
    journal.close()


def test_an_operators_bytes_are_kept_as_they_can_be_shown(path):
    journal = JournalWriter(path, HEADER)
    journal.event(0, 0.0, "INFO", "K\udcfchlung")
    journal.state(0, 0.0, 0.0, "running", "abort", "finishing", "K\udcfchlung")
    journal.commit()
    assert read(path)[1] == ["K\\xfchlung"]
    journal.close()


@pytest.mark.parametrize("how", ["deleted", "moved", "replaced"])
def test_a_file_that_is_lost_is_noticed_within_a_second(how, path, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    journal = JournalWriter(folder / "journal.sqlite", HEADER)
    sample(journal, 0)
    journal.commit()
    if how == "deleted":
        shutil.rmtree(folder)
    elif how == "moved":
        folder.rename(tmp_path / "elsewhere")
    else:
        (folder / "journal.sqlite").rename(folder / "old.sqlite")
        (folder / "journal.sqlite").write_bytes(b"")
    wait_until(lambda: journal.failure is not None)
    with pytest.raises(JournalError, match="while the run goes on"):
        journal.check()
    journal.close()


@pytest.mark.parametrize("how", ["deleted", "replaced"])
def test_a_file_that_is_lost_in_the_midst_of_a_write_is_noticed_too(how, path):
    store = JournalStore(path, HEADER, again=False)
    assert store.lost() is None
    if how == "deleted":
        for one in path.parent.glob("journal.sqlite*"):
            one.unlink()
    else:
        path.rename(path.with_name("old.sqlite"))
        path.write_bytes(b"")
    store.write([("sample", (0, 0.0, 0.0, 0.0, 20.0, b"\0", b"\0" * 8))])
    assert "while the run goes on" in str(store.lost())
    store.close(tidy=False)


def copied_over(path, other):
    shutil.copyfile(other, path)


def restored_into(path, other):
    with contextlib.closing(sqlite3.connect(other)) as source, contextlib.closing(sqlite3.connect(path)) as target:
        source.backup(target)


def moved_onto(path, other):
    other.replace(path)


def emptied(path, other):
    path.write_bytes(b"")


def log_deleted(path, other):
    path.with_name("journal.sqlite-wal").unlink()


def rows_deleted(path, other):
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM samples WHERE tick = 3")


@pytest.mark.parametrize("how", [copied_over, restored_into, moved_onto, emptied, log_deleted, rows_deleted])
@pytest.mark.parametrize("whose", ["another run's", "an older copy of its own"])
def test_a_journal_that_is_overwritten_in_place_is_noticed_within_a_second(how, whose, path, tmp_path):
    journal = JournalWriter(path, HEADER)
    other = tmp_path / "other.sqlite"
    for tick in range(200):
        sample(journal, tick)
    journal.commit()
    if whose == "another run's":
        another = JournalWriter(other, HEADER)
        sample(another, 0)
        another.close()
    else:
        with contextlib.closing(sqlite3.connect(path)) as source, contextlib.closing(sqlite3.connect(other)) as target:
            source.backup(target)
    for tick in range(200, 2000):
        sample(journal, tick)
    journal.commit()
    with contextlib.closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA wal_checkpoint").fetchall()  # else the log beside the file still holds every row
    time.sleep(0.6)
    assert journal.failure is None
    how(path, other)
    wait_until(lambda: journal.failure is not None)
    with pytest.raises(JournalError, match="while the run goes on"):
        journal.check()
    if how in (copied_over, restored_into):
        held = other.read_bytes() if how is copied_over else None
        sample(journal, 2000)
        journal.event(0, 0.0, "INFO", "the end")
        time.sleep(0.2)
        assert held is None or path.read_bytes() == held  # nothing is written into what is not the journal
    with contextlib.suppress(JournalError):
        journal.close()


def test_a_lock_a_reader_and_a_checkpoint_of_another_program_are_no_loss(path):
    journal = JournalWriter(path, HEADER)
    for tick in range(500):
        sample(journal, tick)
    journal.commit()
    for statement in ("BEGIN IMMEDIATE", "ROLLBACK", "SELECT count(*) FROM samples", "PRAGMA wal_checkpoint"):
        with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as database:
            database.execute(statement if statement != "ROLLBACK" else "BEGIN").fetchall()
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE notes (text TEXT)")
    for tick in range(500, 520):
        sample(journal, tick)
    time.sleep(0.7)
    journal.commit()
    assert journal.failure is None
    journal.close()


def test_events_and_samples_become_durable_without_a_commit(path):
    journal = JournalWriter(path, HEADER)
    sample(journal, 0)
    journal.event(0, 0.0, "WARN", "seen")
    wait_until(lambda: read(path) == ([0], ["seen"]), within_s=10.0)
    sample(journal, 1)
    wait_until(lambda: read(path)[0] == [0, 1], within_s=10.0)
    assert read(path) == ([0, 1], ["seen"])
    journal.close()


def test_states_of_older_journals_are_read_under_their_present_names(path):
    journal = JournalWriter(path, HEADER)
    journal.state(0, 0.0, 0.0, "connecting", "soak", "soaking", "as version 0.1 wrote it")
    journal.state(1, 0.1, 0.0, "soaking", "start", "running", "")
    journal.close()
    reader = JournalReader(path)
    steps = [(row.source, row.event, row.target) for row in reader.states()]
    reader.close()
    assert steps == [("connecting", "restore", "restoring"), ("restoring", "start", "running")]
