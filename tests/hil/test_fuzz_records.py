"""Mutated records and profiles: read, or refused with one sentence that names the file."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from hil.bench.fuzz import records as fuzz_records
from hil.bench.fuzz.records import IMPOSSIBLE, READ, REFUSED, TRACEBACK, UNCLEAR, mutated_csv, mutated_parquet
from hil.record.reader import Record, RecordError


@pytest.mark.parametrize("kind", ["csv", "parquet", "profile"])
def test_mutated_files_are_read_or_refused_in_one_sentence(kind: str) -> None:
    found = fuzz_records.fuzz_records(150, 2026, kinds=(kind,))[kind]
    assert found.failures == 0, found.examples
    assert found.counts[READ] > 0 and found.counts[REFUSED] > 0
    assert sum(found.counts.values()) == 150


def test_the_mutations_are_those_of_the_seed() -> None:
    for make in (mutated_csv, mutated_parquet):
        assert [make(random.Random(k)) for k in range(5)] == [make(random.Random(k)) for k in range(5)]


def _refuse(path: Path) -> Record:
    raise RecordError("another file cannot be read")


def _break(path: Path) -> Record:
    raise IndexError("list index out of range")


def _believe(path: Path) -> Record:
    return Record(np.arange(2.0), {"T_tank_C": np.array([20.0, 9.9e37])})


@pytest.mark.parametrize(("reader", "outcome"), [(_refuse, UNCLEAR), (_break, TRACEBACK), (_believe, IMPOSSIBLE)])
def test_a_reader_that_fails_is_found(monkeypatch: pytest.MonkeyPatch, reader: object, outcome: str) -> None:
    monkeypatch.setattr(fuzz_records, "read_record", reader)
    found = fuzz_records.fuzz_records(5, 1, kinds=("csv",))["csv"]
    assert found.counts == {outcome: 5} and found.failures == 5 and len(found.examples) == 5
