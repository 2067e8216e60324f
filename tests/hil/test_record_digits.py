"""Times of records that are digits of a clock or of a date, or have a column for each part."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.record.reader import Record, RecordError, read_record
from tests.hil.command_line import typed

BEGIN = datetime.datetime(2026, 3, 24, 9, 58, 20, tzinfo=datetime.UTC)
STEP = datetime.timedelta(seconds=20)
MOMENTS = [BEGIN + k * STEP for k in range(24)]
"""Eight minutes that pass the end of an hour."""
NIGHT = [
    datetime.datetime(2026, 3, 24, 22, 0, tzinfo=datetime.UTC) + k * datetime.timedelta(minutes=10) for k in range(30)
]


def _read(tmp_path: Path, heading: str, stamps: list[str]) -> Record:
    between = ";" if ";" in heading else ","
    path = tmp_path / "clock.csv"
    rows = "".join(f"{stamp}{between}{20 + k}\n" for k, stamp in enumerate(stamps))
    path.write_text(f"{heading}\n{rows}", encoding="utf-8")
    return read_record(path)


def _number(moment: datetime.datetime, pattern: str) -> str:
    """Write digits as spreadsheets do, without leading zeros."""
    return str(int(moment.strftime(pattern)))


@pytest.mark.parametrize(
    ("heading", "stamps"),
    [
        ("Time,T_in_C", [_number(m, "%H%M%S") for m in MOMENTS]),
        ("Time,T_in_C", [f"{m:%H%M%S}" for m in MOMENTS]),
        ("Uhrzeit;T_in_C", [f"{_number(m, '%H%M%S')},500" for m in MOMENTS]),
        ("HHMMSS,T_in_C", [_number(m, "%H%M%S") for m in MOMENTS]),
        ("Date,Time,T_in_C", [f"{m:%Y%m%d},{_number(m, '%H%M%S')}" for m in MOMENTS]),
        ("Date,Time,T_in_C", [f"{m:%Y-%m-%d},{m:%H%M%S}" for m in MOMENTS]),
        ("Time;Datum;T_in_C", [f"{m:%H%M%S};{_number(m, '%d%m%Y')}" for m in MOMENTS]),
        ("DATE,TIME,T_in_C", [f"{m:%y%m%d},{m:%H%M%S}" for m in MOMENTS]),
        ("YYYYMMDD,HHMMSS,T_in_C", [f"{m:%Y%m%d},{_number(m, '%H%M%S')}" for m in MOMENTS]),
        ("Year,Month,Day,Hour,Min,Sec,T_in_C", [f"{m:%Y},{m:%m},{m:%d},{m:%H},{m:%M},{m:%S}" for m in MOMENTS]),
        ("Tag;Monat;Jahr;Uhrzeit;T_in_C", [f"{m:%d};{m:%m};{m:%Y};{m:%H:%M:%S}" for m in MOMENTS]),
    ],
)
def test_clocks_of_digits_pass_minute_and_hour_without_a_jump(tmp_path: Path, heading: str, stamps: list[str]) -> None:
    record = _read(tmp_path, heading, stamps)
    assert np.allclose(np.diff(record.time_s), 20.0)
    assert sorted(record.columns) == ["T_in_C"]


@pytest.mark.parametrize(
    ("heading", "stamps"),
    [
        ("Time,T_in_C", [_number(m, "%H%M") for m in NIGHT]),
        ("Time (HHMM),T_in_C", [_number(m, "%H%M") for m in NIGHT]),
        ("Date,Time,T_in_C", [f"{m:%Y%m%d},{m:%H%M}" for m in NIGHT]),
        ("Year,DOY,HHMM,T_in_C", [f"{m:%Y},{_number(m, '%j')},{_number(m, '%H%M')}" for m in NIGHT]),
        ("Year,DOY,HHMM,T_in_C", ["2026,83,2340", "2026,83,2350", "2026,83,2400", "2026,84,10", "2026,84,20"]),
    ],
)
def test_hours_and_minutes_in_digits_go_on_over_midnight(tmp_path: Path, heading: str, stamps: list[str]) -> None:
    assert np.allclose(np.diff(_read(tmp_path, heading, stamps).time_s), 600.0)


def test_dates_of_digits_are_days(tmp_path: Path) -> None:
    record = _read(tmp_path, "Date,T_in_C", ["20260130", "20260131", "20260201", "20260202"])
    assert np.allclose(np.diff(record.time_s), 86400.0)


def test_a_date_of_digits_starts_the_record_at_its_moment(tmp_path: Path) -> None:
    record = _read(tmp_path, "Date,Time,T_in_C", [f"{m:%Y%m%d},{_number(m, '%H%M%S')}" for m in MOMENTS])
    assert record.start == BEGIN


@pytest.mark.parametrize(
    "seconds",
    [
        [100 * k for k in range(40)],
        [100 * (k + 1) for k in range(40)],
        [930 + k for k in range(29)],
        [93000 + 7 * k for k in range(60)],
        [1000 * k for k in range(90)],
    ],
)
def test_seconds_that_look_like_a_clock_stay_seconds(tmp_path: Path, seconds: list[int]) -> None:
    record = _read(tmp_path, "Time,T_in_C", [str(second) for second in seconds])
    assert np.allclose(np.diff(record.time_s), np.diff(seconds))


@pytest.mark.parametrize(
    ("heading", "stamps", "said"),
    [
        ("Time,T_in_C", [str(93000 + 100 * k) for k in range(20)], "93000 may be digits of HHMMSS or seconds"),
        ("Date,Time,T_in_C", [f"20260304,{k}" for k in range(20)], r"name the column of times HHMMSS or HHMM"),
        ("HHMM,T_in_C", [str(1250 + 7 * k) for k in range(20)], "its name says HHMM"),
        ("Year,Month,Day,T_in_C", [f"2026,{k + 5},1" for k in range(20)], "'Month' holds 13, which is no month"),
    ],
)
def test_digits_of_two_meanings_are_refused_with_the_name_to_give(
    tmp_path: Path, heading: str, stamps: list[str], said: str
) -> None:
    with pytest.raises(RecordError, match=said):
        _read(tmp_path, heading, stamps)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"time": 0, "T_in_C": 20}\n', "is JSON"),
        ('[{"time": 0}]', "is JSON"),
        ("<!DOCTYPE html><html></html>", "is HTML or XML"),
    ],
)
def test_a_file_of_another_kind_is_named_before_any_column(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "record.csv"
    path.write_text(content, encoding="utf-8")
    done = typed("check", path)
    assert done.returncode == 2 and said in done.stderr and "load profile" not in done.stderr


@pytest.mark.parametrize("cells", [["+ 20.5", "- 3.0", "+ 21.0"], ["2.05D+01", "-3.0d0", "2.1D1"]])
def test_signs_apart_and_exponents_of_fortran_are_numbers(tmp_path: Path, cells: list[str]) -> None:
    path = tmp_path / "record.csv"
    path.write_text("unix,T_in_C\n" + "".join(f"{1772616615 + k},{cell}\n" for k, cell in enumerate(cells)))
    record = read_record(path)
    assert record.columns["T_in_C"].tolist() == [20.5, -3.0, 21.0]
    assert record.start == datetime.datetime(2026, 3, 4, 9, 30, 15, tzinfo=datetime.UTC)


def test_numbers_beyond_a_day_are_no_clock_however_large(tmp_path: Path) -> None:
    table = pa.table({"clock": [1e308, 93015.0, 93016.0], "T_in_C": [20.0, 21.0, 22.0]})
    pq.write_table(table, tmp_path / "record.parquet")
    with pytest.raises(RecordError, match=r"record\.parquet"):
        read_record(tmp_path / "record.parquet")
