"""Files of a folder of Parquet files: many appends leave few files, and no moment of a merger loses or doubles any."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.historian import GOOD, Samples, open_store, parts

APPENDS, TOGETHER = 23, 4


def sample(number: int) -> dict[str, Samples]:
    return {"TI-1": Samples(np.array([60.0 * number]), np.array([float(number)]), np.array([GOOD], np.int16))}


def values(folder: Path) -> list[float]:
    with open_store(folder) as store:
        return sorted(store.read(["TI-1"])["TI-1"].value.tolist())


@pytest.fixture
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts, "TOGETHER", TOGETHER)


@pytest.mark.usefixtures("_small")
def test_files_are_merged_and_each_sample_is_there_once_at_any_moment(tmp_path: Path) -> None:
    folder = tmp_path / "store"
    with open_store(folder, create=True) as store:
        for number in range(APPENDS):
            store.append(sample(number))
            assert values(folder) == list(range(number + 1))
    assert len(list(folder.iterdir())) < APPENDS
    open_store(folder, create=True).close()
    assert len(list(folder.iterdir())) == 1 + 1 + 3  # of 16, of 4 and of one append each
    assert values(folder) == list(range(APPENDS))


@pytest.mark.usefixtures("_small")
def test_a_reader_that_has_listed_the_files_can_finish_after_a_merger(tmp_path: Path) -> None:
    folder = tmp_path / "store"
    with open_store(folder, create=True) as store:
        for number in range(TOGETHER - 1):
            store.append(sample(number))
        listed = list(folder.iterdir())
        store.append(sample(TOGETHER - 1))
        assert all(path.exists() for path in listed)
        assert len(parts.superseded(folder.iterdir())) == TOGETHER


@pytest.mark.usefixtures("_small")
def test_a_merger_that_cannot_be_written_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, whole = tmp_path / "store", parts.pa.concat_tables
    monkeypatch.setattr(parts.pa, "concat_tables", lambda _: (_ for _ in ()).throw(OSError(28, "no space")))
    with open_store(folder, create=True) as store:
        for number in range(TOGETHER):
            store.append(sample(number))
        assert values(folder) == list(range(TOGETHER))
        monkeypatch.setattr(parts.pa, "concat_tables", whole)
        store.append(sample(TOGETHER))
    assert len(parts.superseded(folder.iterdir())) == TOGETHER + 1
    assert values(folder) == list(range(TOGETHER + 1))


@pytest.mark.usefixtures("_small")
def test_stores_of_two_collectors_are_kept_apart(tmp_path: Path) -> None:
    folder = tmp_path / "store"
    with open_store(folder, create=True) as one, open_store(folder, create=True) as other:
        for number in range(0, 12, 2):
            one.append(sample(number))
            other.append(sample(number + 1))
    assert values(folder) == list(range(12))
