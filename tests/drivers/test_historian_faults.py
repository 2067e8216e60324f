"""Stores with other types, damaged files, rows out of order, and places that cannot be written."""

from __future__ import annotations

import errno
import math
import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from drivers.historian import HistorianError, HistorianFailedError, open_store, why_unwritten
from hil.errors import exit_code
from tests.drivers.test_historian import _samples, database, duckdb, psycopg, server  # noqa: F401

STAMP = pa.array([1_600_000_000_000], pa.int64()).cast(pa.timestamp("ms", tz="UTC"))
COLUMNS: dict[str, Any] = {"timestamp": STAMP, "tag": ["A"], "value": [1.0], "quality": [192]}


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"tag": [7]}, "column tag holds int64 and no names; store them as text"),
        ({"value": [[1.0]]}, "column value holds list<"),
        ({"value": STAMP}, "column value holds timestamp"),
        ({"quality": [{"code": 192}]}, "column quality holds struct<"),
        ({"timestamp": [1_600_000_000]}, "column timestamp holds int64 and no times; store timestamps with a zone"),
        ({"quality": [70_000]}, "a value or quality is no number: Integer value 70000 not in range"),
        ({"value": ["1,234"]}, "value '1,234' has a comma: write values as numbers, or with a decimal point"),
    ],
)
def test_a_column_of_another_type_is_named_with_its_file(tmp_path: Path, changed: dict[str, Any], says: str) -> None:
    pq.write_table(pa.table(COLUMNS | changed), tmp_path / "raw.parquet")
    with pytest.raises(HistorianError) as refused, open_store(tmp_path) as store:
        store.tags(), store.span(), store.read(["A"])
    assert says in str(refused.value) and "raw.parquet" in str(refused.value) and "\n" not in str(refused.value)


def test_a_damaged_file_is_named_and_one_of_another_kind_is_left_alone(tmp_path: Path) -> None:
    with open_store(tmp_path, create=True) as store:
        store.append({"A": _samples([1.0], [1.0])})
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "notes.parquet").write_text("only by its name")
    with open_store(tmp_path) as store:
        assert store.tags() == ("A",)
    (whole,) = tmp_path.glob("*.parquet")
    (tmp_path / "old" / "cut.parquet").write_bytes(whole.read_bytes()[:-20])
    with pytest.raises(HistorianError, match=r"old/cut.parquet: is damaged .*restore it, or take it out of the store"):
        open_store(tmp_path)


def test_values_as_text_are_numbers_and_words_are_none(tmp_path: Path) -> None:
    stamps = pa.array([1_600_000_000_000 + 1000 * k for k in range(3)], pa.int64()).cast(pa.timestamp("ms", tz="UTC"))
    rows = {"timestamp": stamps, "tag": ["A"] * 3, "value": ["1.5", "Bad Input", "-2e1"], "quality": [192] * 3}
    pq.write_table(pa.table(rows), tmp_path / "raw.parquet")
    with open_store(tmp_path) as store:
        value = store.read(["A"])["A"].value
    assert value[[0, 2]].tolist() == [1.5, -20.0] and math.isnan(value[1])


@pytest.mark.parametrize("kind", ["TIMESTAMPTZ", "TIMESTAMP_NS", "TIMESTAMP"])
def test_a_duckdb_table_of_nanoseconds_is_read_as_any_other(tmp_path: Path, kind: str) -> None:
    with duckdb.connect(str(tmp_path / "a.duckdb")) as base:
        base.execute("SET TimeZone = 'UTC'")
        base.execute(f"CREATE TABLE samples (timestamp {kind}, tag VARCHAR, value DOUBLE, quality SMALLINT)")
        base.execute(f"INSERT INTO samples VALUES (('2020-09-13 12:26:40+00'::TIMESTAMPTZ)::{kind}, 'A', 1.5, 192)")
    with open_store(tmp_path / "a.duckdb") as store:
        assert store.span() == (1_600_000_000.0, 1_600_000_000.0)
        read = store.read(["A"], 1_599_999_999.0, 1_600_000_001.0)["A"]
    assert read.time_s.tolist() == [1_600_000_000.0] and read.value.tolist() == [1.5]


def test_a_duckdb_column_of_another_type_is_named(tmp_path: Path) -> None:
    for name, kind in (("timestamp", "BIGINT"), ("tag", "INTEGER"), ("value", "DOUBLE[]"), ("quality", "VARCHAR")):
        kinds = {"timestamp": "TIMESTAMPTZ", "tag": "VARCHAR", "value": "DOUBLE", "quality": "SMALLINT", name: kind}
        path = tmp_path / f"{name}.duckdb"
        with duckdb.connect(str(path)) as base:
            base.execute(f"CREATE TABLE samples ({', '.join(f'{n} {k}' for n, k in kinds.items())})")
        with pytest.raises(HistorianError, match=rf"column {name} of table 'samples' is .*; make it"):
            open_store(path)


@pytest.mark.parametrize(("name", "kind"), [("tag", "integer"), ("value", "text"), ("quality", "text")])
def test_a_postgres_column_of_another_type_is_named(database: str, name: str, kind: str) -> None:  # noqa: F811
    kinds = {"timestamp": "timestamptz", "tag": "text", "value": "float8", "quality": "int", name: kind}
    with psycopg.connect(database) as base:
        base.execute(f"CREATE TABLE samples ({', '.join(f'{n} {k}' for n, k in kinds.items())})")
    with pytest.raises(HistorianError, match=rf"column {name} of table 'samples' is {kind}; make it"):
        open_store(database)


def _fill(url: str, rows: list[tuple[int, float, int]]) -> None:
    with psycopg.connect(url) as base:
        base.execute("CREATE TABLE samples (timestamp timestamptz, tag text, value numeric, quality int)")
        for second, value, quality in rows:
            base.execute("INSERT INTO samples VALUES (to_timestamp(%s), 'A', %s, %s)", [second, value, quality])


def test_a_quality_that_is_no_code_is_named(database: str) -> None:  # noqa: F811
    _fill(database, [(1, 1.0, 192), (2, 2.0, 70_000)])
    with (
        open_store(database) as store,
        pytest.raises(HistorianError, match="tag A has the quality 70000, which is no OPC code"),
    ):
        store.read(["A"])


def test_a_database_gives_samples_as_they_were_stored(
    database: str,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from drivers.historian import postgres

    monkeypatch.setattr(postgres, "ROWS", 2)  # so that the order goes beyond a piece
    _fill(database, [(30, 1.0, 192), (10, 2.0, 192), (20, 3.0, 192), (20, 4.0, 192), (5, 5.0, 192)])
    with open_store(database) as store:
        assert store.read(["A"])["A"].value.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]


def test_a_view_is_read_in_the_order_of_time(database: str) -> None:  # noqa: F811
    _fill(database, [(30, 1.0, 192), (10, 2.0, 192)])
    with psycopg.connect(database) as base:
        base.execute("ALTER TABLE samples RENAME TO stored")
        base.execute("CREATE VIEW samples AS SELECT * FROM stored")
    with open_store(database) as store:
        assert store.read(["A"])["A"].value.tolist() == [2.0, 1.0]


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "make room"),
        (errno.EDQUOT, "make room"),
        (errno.EROFS, "choose a place that can be written"),
        (errno.EACCES, "choose a place that this user may write"),
        (errno.ENOTDIR, "choose another path"),
    ],
)
def test_a_reason_has_its_own_remedy(number: int, remedy: str) -> None:
    assert why_unwritten(OSError(number, os.strerror(number))) == f"{os.strerror(number)}; {remedy}"


def test_a_store_that_fails_while_it_is_used_is_told_from_one_that_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(tmp_path / "s", create=True)

    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(pq, "write_table", read_only)
    with pytest.raises(HistorianFailedError, match="Read-only file system; choose a place that can be written"):
        store.append({"A": _samples([1.0], [1.0])})
    with pytest.raises(HistorianError) as missing:
        open_store(tmp_path / "nothing")
    assert exit_code(missing.value) == 2 and exit_code(HistorianFailedError("a disk is full")) == 1
    assert not isinstance(missing.value, HistorianFailedError)
