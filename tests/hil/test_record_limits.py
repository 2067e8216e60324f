"""Readers refuse what would take more memory than is there, before they allocate it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.diagnosis.store import DiagnosisFolderError, read_curves
from hil.files import limits as record_limits
from hil.files.limits import limit_bytes, require_size
from hil.profile.load_profile import ProfileError, read_profile
from hil.record.file import RecordError
from hil.record.reader import read_record

ROWS = 4_000_000


def runs_of_one_value(path: Path, columns: int = 8, rows: int = ROWS) -> Path:
    one = pa.array(np.zeros(rows))
    pq.write_table(pa.table({"time_s": pa.array(np.arange(rows)), **{f"T{k}_C": one for k in range(columns)}}), path)
    return path


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_READ_LIMIT", "100M")


@pytest.mark.usefixtures("small")
def test_a_small_file_of_many_equal_values_is_refused_by_its_footer(tmp_path: Path) -> None:
    rows = 10_000_000
    path = tmp_path / "bomb.parquet"
    pq.write_table(pa.table({"time_s": pa.array(np.zeros(rows)), "T_C": pa.array(np.zeros(rows))}), path)
    assert path.stat().st_size < 100_000
    with pytest.raises(RecordError, match="10000000 rows of 2 columns and would take 480 MB") as caught:
        read_record(path)
    message = str(caught.value)
    assert "bomb.parquet" in message and "limit of 100 MB" in message and re.search(r"HIL_READ_LIMIT .* \d+G", message)


@pytest.mark.usefixtures("small")
def test_texts_that_a_dictionary_repeats_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    rows = 100_000
    text = pa.DictionaryArray.from_arrays(pa.array(np.zeros(rows, dtype=np.int32)), pa.array(["x" * 100_000]))
    path = tmp_path / "texts.parquet"
    pq.write_table(pa.table({"time_s": pa.array(np.arange(rows) * 1.0), "note": text}), path)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(RecordError, match=r"texts of 10 GB in 100000 rows .* limit of 100 MB"):
        read_record(path)


@pytest.mark.usefixtures("small")
def test_texts_that_are_few_are_read_as_ever(tmp_path: Path) -> None:
    stamps = [f"2026-01-01T00:00:{s:02d}Z" for s in range(30)]
    path = tmp_path / "stamps.parquet"
    pq.write_table(pa.table({"time": pa.array(stamps), "T_C": pa.array(np.arange(30.0))}), path)
    record = read_record(path)
    assert record.time_s.tolist() == list(range(30))


@pytest.mark.usefixtures("small")
def test_columns_of_lists_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "lists.parquet"
    lists = pa.ListArray.from_arrays(pa.array([0, 5_000_000, 10_000_000]), pa.array(np.zeros(10_000_000)))
    pq.write_table(pa.table({"time_s": pa.array([0.0, 1.0]), "many": lists, "T_in_C": [20.0, 21.0]}), path)
    record = read_record(path)
    assert (
        list(record.columns) == ["T_in_C"] and "column 'many' holds list<element: double>: dropped" in record.messages
    )


def test_damaged_statistics_of_sizes_are_refused_and_do_not_end_the_process(tmp_path: Path) -> None:
    path = tmp_path / "statistics.parquet"
    pq.write_table(pa.table({"time_s": [0.0, 1.0, None], "T_in_C": [20.0, 21.0, 22.0]}), path, compression="none")
    sound = path.read_bytes()
    footer = int.from_bytes(sound[-8:-4], "little")
    script = (
        "import sys, pathlib\nfrom hil.record.reader import RecordError, read_record\n"
        "path, sound, end = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[1]).read_bytes(), int(sys.argv[2])\n"
        "for at in range(len(sound) - 8 - end, len(sound) - 8):\n"
        "    for bit in (1, 8, 16):\n"
        "        path.write_bytes(sound[:at] + bytes([sound[at] ^ bit]) + sound[at + 1 :])\n"
        "        try:\n            read_record(path)\n        except RecordError:\n            pass\n"
    )
    done = subprocess.run([sys.executable, "-c", script, str(path), str(footer)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_too_many_columns_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_COLUMN_LIMIT", "50")
    names = ["time_s", *(f"T{k}_C" for k in range(60))]
    pq.write_table(pa.table({name: pa.array([0.0, 1.0]) for name in names}), tmp_path / "wide.parquet")
    (tmp_path / "wide.csv").write_text("\n".join([",".join(names), *[",".join("0" * 61)] * 2]), encoding="utf-8")
    for path in (tmp_path / "wide.parquet", tmp_path / "wide.csv"):
        with pytest.raises(RecordError, match=r"has 61 columns, and at most 50 are read.*HIL_COLUMN_LIMIT"):
            read_record(path)


@pytest.mark.parametrize("annotated", [False, True])
@pytest.mark.usefixtures("small")
def test_readings_that_would_spread_over_many_columns_are_refused_before_they_do(
    tmp_path: Path, annotated: bool
) -> None:
    path = tmp_path / "long.csv"
    if annotated:
        table = "#datatype,string\n,time,T{k}_C\n" + ",2026-01-01T00:00:00Z,1\n" * 20 + "\n"
        path.write_text("".join(table.replace("{k}", str(k)) for k in range(400)), encoding="utf-8")
    else:
        rows = "".join(
            f"2026-01-01T{k // 3600:02d}:{k // 60 % 60:02d}:{k % 60:02d}Z,s{k % 1000},{k}\n" for k in range(9000)
        )
        path.write_text("time,series,value\n" + rows, encoding="utf-8")
    with pytest.raises(RecordError, match=r"long\.csv has \d+ times of \d+ columns .* limit of 100 MB"):
        read_record(path)


def test_a_large_csv_is_refused_by_its_size_alone(tmp_path: Path, small: None) -> None:
    path = tmp_path / "large.csv"
    with path.open("wb") as file:
        file.truncate(10**12)  # a hole: there is nothing to read but its size
    with pytest.raises(RecordError, match=r"large\.csv has 1e\+03 GB .* limit of 100 MB"):
        read_record(path)
    with pytest.raises(ProfileError, match=r"large\.csv has .* limit"):
        read_profile(path)


@pytest.mark.usefixtures("small")
def test_the_curves_of_a_diagnosis_have_the_same_limit(tmp_path: Path) -> None:
    with pytest.raises(DiagnosisFolderError, match="HIL_READ_LIMIT"):
        read_curves(runs_of_one_value(tmp_path / "diagnosis.parquet"))


@pytest.mark.parametrize(("text", "size"), [("1000", 1000), ("2K", 2000), ("3 M", 3 * 10**6), ("4gb", 4 * 10**9)])
def test_the_limit_can_be_set(monkeypatch: pytest.MonkeyPatch, text: str, size: int) -> None:
    monkeypatch.setenv("HIL_READ_LIMIT", text)
    assert limit_bytes() == size


@pytest.mark.parametrize("text", ["many", "-1", "1T", "1e9", "9" * 30])
def test_a_limit_that_is_no_size_is_refused(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("HIL_READ_LIMIT", text)
    with pytest.raises(RecordError, match=r"HIL_READ_LIMIT is .* no size; write bytes"):
        limit_bytes(RecordError)


def test_without_a_setting_it_follows_the_memory_that_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HIL_READ_LIMIT", raising=False)
    monkeypatch.setattr(record_limits, "_free_bytes", lambda: 10**9)
    assert limit_bytes() == 250 * 10**6
    monkeypatch.setattr(record_limits, "_free_bytes", lambda: 10**12)
    assert limit_bytes() == record_limits.CEILING


def test_what_has_no_end_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    for path in (tmp_path / "pipe.csv", Path("/dev/zero")):
        with pytest.raises(RecordError, match="is no regular file"):
            require_size(path, RecordError)
        with pytest.raises(RecordError, match="is no regular file"):
            read_record(path)


CHECK = """
import resource, sys
from pathlib import Path
from hil.record.reader import read_record
read_record(Path(sys.argv[1]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


def test_what_is_let_through_takes_no_more_than_was_foreseen(tmp_path: Path) -> None:
    rows, columns = 500_000, 20
    few = runs_of_one_value(tmp_path / "few.parquet", columns, 100)
    many = runs_of_one_value(tmp_path / "many.parquet", columns, rows)
    used = []
    for path in (few, many):
        command = [sys.executable, "-c", CHECK, str(path)]
        used.append(int(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
    assert used[1] - used[0] < 1.2 * record_limits.COPIES * 8 * rows * (columns + 1)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_too_many_columns_are_refused_by_the_heading(tmp_path: Path, delimiter: str) -> None:
    count = 20_001
    path = tmp_path / "wide.csv"
    lines = [["time_s", *(f"c{k}_C" for k in range(count - 1))], *([str(20 + row)] * count for row in range(3))]
    path.write_text("\n".join(delimiter.join(line) for line in lines) + "\n", encoding="utf-8")
    began = time.monotonic()
    with pytest.raises(RecordError, match=rf"^{re.escape(str(path))} has {count} columns, and at most 4096 are read"):
        read_record(path)
    assert time.monotonic() - began < 5.0  # to interpret the heading first takes 15 s


def test_a_limit_of_columns_that_is_no_number_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HIL_COLUMN_LIMIT", "many")
    path = tmp_path / "record.csv"
    path.write_text("time_s,T_C\n0,20\n1,21\n", encoding="utf-8")
    with pytest.raises(RecordError, match=r"record\.csv: HIL_COLUMN_LIMIT is 'many', which is no number of columns"):
        read_record(path)
