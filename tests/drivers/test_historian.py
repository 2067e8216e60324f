"""Historians of three kinds behind one protocol, and what they say when something is wrong."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from drivers.historian import HistorianAwayError, HistorianError, HistorianStore, Samples, open_store
from tests.drivers.postgres_server import Server, emptied, serving

duckdb = pytest.importorskip("duckdb", reason="duckdb is not installed")
psycopg = pytest.importorskip("psycopg", reason="psycopg is not installed")


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    yield from serving()


@pytest.fixture
def database(server: Server) -> str:
    """URL of an empty database."""
    return emptied(server, "plant")


@pytest.fixture(params=["folder", "duckdb", "postgres"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "postgres":
        url: str = request.getfixturevalue("database")
        return url
    return str(tmp_path / ("store" if request.param == "folder" else "store.duckdb"))


def _samples(times: list[float], values: list[float], quality: int = 192) -> Samples:
    return Samples(np.array(times), np.array(values), np.full(len(times), quality, dtype=np.int16))


def _same(a: Samples, b: Samples) -> bool:
    return bool(
        np.allclose(a.time_s, b.time_s, atol=5e-4)
        and np.array_equal(a.value, b.value, equal_nan=True)
        and np.array_equal(a.quality, b.quality)
    )


def test_what_was_appended_is_read_again(address: str) -> None:
    first = {"A.PV": _samples([1e9, 1e9 + 0.125], [1.5, 2.25]), "B\twith tab": _samples([1e9 + 7], [3.0], 64)}
    with open_store(address, create=True) as store:
        assert store.tags() == () and store.span() is None
        store.append(first)
        store.append({"A.PV": _samples([1e9 + 60.0], [float("nan")], 0)})
    with open_store(address) as store:
        assert store.tags() == ("A.PV", "B\twith tab")
        assert store.span() == pytest.approx((1e9, 1e9 + 60.0))
        read = store.read(["A.PV", "B\twith tab", "absent"])
    assert _same(read["A.PV"], _samples([1e9, 1e9 + 0.125, 1e9 + 60.0], [1.5, 2.25, float("nan")]) | _bad(2))
    assert _same(read["B\twith tab"], first["B\twith tab"])
    assert len(read["absent"]) == 0


def test_a_span_of_time_is_read_with_its_beginning_and_without_its_end(address: str) -> None:
    with open_store(address, create=True) as store:
        store.append({"A": _samples([100.0, 200.0, 300.0], [1.0, 2.0, 3.0])})
        assert store.read(["A"], 200.0, 300.0)["A"].value.tolist() == [2.0]
        assert store.read(["A"], start_s=250.0)["A"].value.tolist() == [3.0]


def test_samples_of_one_time_stamp_are_all_kept(address: str) -> None:
    with open_store(address, create=True) as store:
        store.append({"A": _samples([100.0, 100.0, 100.0], [1.0, 1.0, 2.0])})
        assert store.read(["A"])["A"].value.tolist() == [1.0, 1.0, 2.0]


def test_a_store_that_is_not_there_is_named(tmp_path: Path) -> None:
    for name in ("nothing", "nothing.duckdb"):
        with pytest.raises(HistorianError, match=rf"{name}: there is no historian; check the path"):
            open_store(tmp_path / name)


def test_a_scheme_that_no_store_has_is_refused_without_its_password() -> None:
    with pytest.raises(HistorianError, match="mysql:// is no historian") as refused:
        open_store("mysql://plant:secret@host/base")
    assert "secret" not in str(refused.value)


def test_parquet_files_without_the_columns_are_named(tmp_path: Path) -> None:
    pq.write_table(pa.table({"timestamp": [1], "name": ["a"], "value": [1.0]}), tmp_path / "raw.parquet")
    with pytest.raises(HistorianError, match=r"no Parquet file here has the columns.*raw.parquet lacks quality, tag"):
        open_store(tmp_path)


def test_a_file_that_is_no_parquet_is_named(tmp_path: Path) -> None:
    (tmp_path / "raw.parquet").write_text("timestamp,tag\n")
    with pytest.raises(HistorianError, match=r"raw.parquet is no Parquet file"):
        open_store(tmp_path)


def test_further_parquet_files_of_the_folder_are_left_alone(tmp_path: Path) -> None:
    with open_store(tmp_path / "s", create=True) as store:
        store.append({"A": _samples([1.0], [1.0])})
    pq.write_table(pa.table({"time": [1], "truth": [2.0]}), tmp_path / "s" / "truth.parquet")
    with open_store(tmp_path / "s") as store:
        assert store.tags() == ("A",)


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_times_of_every_resolution_and_plain_strings_as_tags_are_read(tmp_path: Path, unit: str) -> None:
    factor = {"s": 1, "ms": 10**3, "us": 10**6, "ns": 10**9}[unit]
    stamps = pa.array([1_600_000_000 * factor], pa.int64()).cast(pa.timestamp(unit, tz="UTC"))
    table = pa.table({"timestamp": stamps, "tag": ["A"], "value": pa.array([1], pa.int32()), "quality": [192]})
    pq.write_table(table, tmp_path / "raw.parquet")
    with open_store(tmp_path) as store:
        assert store.read(["A"])["A"].time_s.tolist() == [1.6e9]


def test_a_full_disk_leaves_no_part_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = open_store(tmp_path / "s", create=True)

    def full(table: object, path: Path, **_: object) -> None:
        Path(path).write_bytes(b"begun")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pq, "write_table", full)
    with pytest.raises(HistorianError, match=r"1 samples could not be written: No space left on device; make room"):
        store.append({"A": _samples([1.0], [1.0])})
    assert list((tmp_path / "s").iterdir()) == []


def test_a_duckdb_file_without_the_table_or_a_column_is_named(tmp_path: Path) -> None:
    with duckdb.connect(str(tmp_path / "a.duckdb")) as base:
        base.execute("CREATE TABLE other (x INT)")
    with pytest.raises(HistorianError, match=r"a.duckdb: has no table 'samples'"):
        open_store(tmp_path / "a.duckdb")
    with duckdb.connect(str(tmp_path / "b.duckdb")) as base:
        base.execute("CREATE TABLE samples (timestamp TIMESTAMPTZ, tag VARCHAR, value DOUBLE)")
    with pytest.raises(HistorianError, match=r"table 'samples' lacks the column quality"):
        open_store(tmp_path / "b.duckdb")


def test_a_database_without_the_table_or_a_column_is_named_without_password(database: str, server: Server) -> None:
    with pytest.raises(HistorianError, match="has no table 'samples'") as refused:
        open_store(database)
    with psycopg.connect(database) as base:
        base.execute("CREATE TABLE samples (timestamp timestamptz, tag text, quality smallint)")
    with pytest.raises(HistorianError, match="lacks the column value") as lacking:
        open_store(database)
    for error in (refused, lacking):
        assert "horse" not in str(error.value) and "plant@" in str(error.value)


def test_a_refused_password_is_one_sentence_without_it(server: Server) -> None:
    with pytest.raises(HistorianError, match="refused the password; check user and password") as refused:
        open_store(server.url(password="hunter2"))
    assert "hunter2" not in str(refused.value) and "\n" not in str(refused.value)


def test_a_database_that_is_not_there_is_one_sentence(server: Server) -> None:
    with pytest.raises(HistorianError, match=r"cannot be reached: .*nowhere") as refused:
        open_store(server.url(database="nowhere"))
    assert "\n" not in str(refused.value) and "correct" not in str(refused.value)


def test_reading_goes_on_where_it_was_when_the_database_went_away(
    database: str, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    from drivers.historian import postgres

    monkeypatch.setattr(postgres, "ROWS", 400)
    times = np.repeat(np.arange(1000.0), 2)  # every time twice, so that a piece ends between two of one time
    with open_store(database, create=True) as store:
        store.append({"A": Samples(times, np.arange(2000.0), np.full(2000, 192, dtype=np.int16))})
        pieces = 0
        plain = type(store)._piece  # type: ignore[attr-defined]

        def interrupted(self: HistorianStore, *arguments: object) -> Samples:
            nonlocal pieces
            pieces += 1
            if pieces == 3:
                server.stop()
                threading.Thread(target=lambda: (time.sleep(0.5), server.start())).start()
            found: Samples = plain(self, *arguments)
            return found

        monkeypatch.setattr(type(store), "_piece", interrupted)
        read = store.read(["A"])["A"]
    assert read.value.tolist() == list(range(2000))
    assert pieces > 5


def test_a_database_that_stays_away_is_one_sentence(database: str, server: Server) -> None:
    from drivers.historian.postgres import PostgresStore

    said: list[str] = []
    store = PostgresStore(database, create=True, patience_s=0.5, say=said.append)
    server.stop()
    try:
        with pytest.raises(HistorianError, match=r"went away and did not come back within 0.5 s") as gone:
            store.read(["A"])
        with pytest.raises(HistorianAwayError):
            store.read(["A"])
    finally:
        server.start()
    assert "correct" not in str(gone.value)
    assert store.tags() == ()
    assert [one.split(": ")[1].split(";")[0] for one in said] == ["went away", "is back"]
    store.close()


def test_an_index_by_blocks_stands_where_timescale_is_not(database: str) -> None:
    open_store(database, create=True).close()
    with psycopg.connect(database) as base:
        kinds = {
            row[0] for row in base.execute("SELECT indexdef FROM pg_indexes WHERE tablename = 'samples'").fetchall()
        }
        timescale = base.execute("SELECT 1 FROM pg_extension WHERE extname = 'timescaledb'").fetchone()
    assert timescale or any("brin" in kind for kind in kinds)


class _bad:
    """Quality 0 at a row, by `samples | _bad(row)`."""

    def __init__(self, row: int) -> None:
        self.row = row

    def __ror__(self, samples: Samples) -> Samples:
        quality = samples.quality.copy()
        quality[self.row] = 0
        return Samples(samples.time_s, samples.value, quality)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(HistorianError, match="cannot be made"):
        open_store(tmp_path / "file" / "store", create=True)
    assert os.path.isfile(tmp_path / "file")
