"""Times of a record: one way of writing for a column, in one column or two, read or refused with a remedy."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.record.reader import ReadingOptions, Record, RecordError, read_record

BEGIN = datetime.datetime(2026, 3, 4, 23, 40, tzinfo=datetime.UTC)
STEP = datetime.timedelta(minutes=2)
MOMENTS = [BEGIN + k * STEP for k in range(30)]
"""An hour over midnight of a night in March, when neither day is above twelve."""


def _read(tmp_path: Path, heading: str, stamps: list[str], **choice: object) -> Record:
    path = tmp_path / "times.csv"
    between = ";" if ";" in heading else ","
    rows = "".join(f"{stamp}{between}{20 + k}\n" for k, stamp in enumerate(stamps))
    path.write_text(f"{heading}\n{rows}", encoding="utf-8")
    return read_record(path, choice=ReadingOptions(**choice))  # type: ignore[arg-type]


def _written(pattern: str) -> list[str]:
    return [moment.strftime(pattern) for moment in MOMENTS]


def _day_number(moment: datetime.datetime) -> float:
    return (moment - datetime.datetime(1899, 12, 30, tzinfo=datetime.UTC)) / datetime.timedelta(days=1)


@pytest.mark.parametrize(
    ("heading", "stamps"),
    [
        ("time_s,T_in_C", _written("%Y-%m-%dT%H:%M:%SZ")),
        ("Time,T_in_C", _written("%Y/%m/%d %H:%M")),
        ("Datum;T_in_C", _written("%d.%m.%Y %H:%M:%S")),
        ("Zeitstempel;T_in_C", _written("%d.%m.%y %H:%M:%S,000")),
        ("Timestamp,T_in_C", _written("%m/%d/%Y %I:%M:%S %p")),
        ("Timestamp,T_in_C", _written("%d/%m/%Y %H:%M:%S")),
        ("Timestamp,T_in_C", _written("%d-%b-%Y %H:%M:%S.250")),
        ("written at,T_in_C", _written("%a %d %b %Y %H:%M")),
        ("timestamp,T_in_C", _written("%Y%m%d%H%M%S")),
        ("timestamp,T_in_C", _written("%Y%m%d %H%M%S")),
        ("Date,Time,T_in_C", _written("%Y-%m-%d,%H:%M:%S")),
        ("Time;Date;T_in_C", _written("%H:%M;%d.%m.%Y")),
        ("Date,Time,T_in_C", _written("%m/%d/%Y,%I:%M %p")),
        ("Day;Clock;T_in_C", _written("%d.%m.%Y;%H:%M:%S")),
        ("Date;T_in_C", [f"{_day_number(moment):.8f}".replace(".", ",") for moment in MOMENTS]),
        ("Time,T_in_C", [f"{_day_number(moment):.8f}" for moment in MOMENTS]),
        ("Date,Time,T_in_C", [f"{_day_number(moment) // 1:.0f},{_day_number(moment) % 1:.8f}" for moment in MOMENTS]),
        ("epoch,T_in_C", [f"{moment.timestamp():.0f}" for moment in MOMENTS]),
        ("epoch,T_in_C", [f"{moment.timestamp() * 1000:.0f}" for moment in MOMENTS]),
        ("epoch,T_in_C", [f"{moment.timestamp():.0f}000000" for moment in MOMENTS]),
    ],
)
def test_every_way_to_write_a_moment_gives_the_same_times(tmp_path: Path, heading: str, stamps: list[str]) -> None:
    record = _read(tmp_path, heading, stamps)
    assert record.time_s == pytest.approx([120.0 * k for k in range(30)])
    assert record.columns["T_in_C"].tolist() == [20.0 + k for k in range(30)]
    assert record.start is not None and record.start.replace(microsecond=0) == BEGIN


def test_times_of_day_go_on_over_midnight(tmp_path: Path) -> None:
    record = _read(tmp_path, "Time,T_in_C", _written("%H:%M:%S"))
    assert record.time_s.tolist() == [120.0 * k for k in range(30)] and record.start is None
    assert "Time: a gap of a day or more cannot be seen in it" in record.messages


def test_hours_above_a_day_are_a_time_since_the_beginning(tmp_path: Path) -> None:
    record = _read(tmp_path, "elapsed,T_in_C", [f"{20 + k}:00:00" for k in range(30)])
    assert record.time_s.tolist() == [3600.0 * k for k in range(30)]


def test_two_numbers_of_a_time_are_refused_without_a_date(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="'10:00' may be hours and minutes or minutes and seconds; write hh:mm:ss"):
        _read(tmp_path, "Time,T_in_C", [f"10:{k:02}" for k in range(30)])


def test_days_of_which_none_is_above_twelve_are_refused_until_their_order_is_given(tmp_path: Path) -> None:
    stamps = [f"0{1 + k}/05/2026 06:00" for k in range(8)]
    with pytest.raises(RecordError, match=r"may be day.month.year or month/day/year; give one of --dates dmy"):
        _read(tmp_path, "Date,T_in_C", stamps)
    assert _read(tmp_path, "Date,T_in_C", stamps, dates="dmy").time_s[1] == 86400
    assert _read(tmp_path, "Date,T_in_C", stamps, dates="mdy").time_s[1] == 31 * 86400


@pytest.mark.parametrize(("first", "order"), [("13/05/2026", "day/month/year"), ("05/13/2026", "month/day/year")])
def test_a_number_above_twelve_settles_the_order(tmp_path: Path, first: str, order: str) -> None:
    record = _read(tmp_path, "Date,T_in_C", [f"{first} 06:{k:02}" for k in range(30)])
    assert record.start == datetime.datetime(2026, 5, 13, 6, tzinfo=datetime.UTC)
    assert f"Date is {order} without a time zone" in record.messages[0]


def test_a_single_day_of_either_order_is_read_and_its_date_left_open(tmp_path: Path) -> None:
    record = _read(tmp_path, "Date,T_in_C", [f"03/04/2026 06:{k:02}" for k in range(30)])
    assert record.time_s[-1] == 29 * 60
    assert any("only the date of the record depends on it (--dates settles it)" in said for said in record.messages)


def test_dates_without_times_are_refused_where_rows_would_be_lost(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"29 of 32 values of column 'T_in_C' stand at a time that another row has"):
        _read(tmp_path, "Date,T_in_C", ["2026-03-04"] * 30 + ["2026-03-05", "2026-03-06"])


def test_a_column_of_one_time_is_named_as_such(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"all 30 rows have one time in column 'Date'; name the column that counts"):
        _read(tmp_path, "Date,T_in_C", ["2026-03-04"] * 30)


def test_one_row_a_device_at_the_same_time_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "devices.csv"
    path.write_text("time_s,a_W,b_W\n" + "".join(f"{k},{k},\n{k},,{k}\n" for k in range(30)), encoding="utf-8")
    record = read_record(path)
    assert record.columns["a_W"].tolist() == record.columns["b_W"].tolist() == list(range(30))


@pytest.mark.parametrize(("broken", "read"), [(2, True), (3, False)])
def test_rows_without_a_time_are_dropped_up_to_a_twentieth(tmp_path: Path, broken: int, read: bool) -> None:
    stamps = ["soon" if k < broken else f"2026-03-04 10:00:{k:02}" for k in range(10, 60)]
    stamps[5 : 5 + broken] = ["soon"] * broken
    if read:
        assert len(_read(tmp_path, "Date,T_in_C", stamps).time_s) == 50 - broken
        return
    with pytest.raises(RecordError, match=r"3 of 50 rows have no readable time in column 'Date' \(the first is lin"):
        _read(tmp_path, "Date,T_in_C", stamps)


def test_rows_without_any_cell_are_no_loss(tmp_path: Path) -> None:
    path = tmp_path / "tail.csv"
    path.write_text("time_s;T_in_C\n0;20\n1;21\n" + ";\n" * 50, encoding="utf-8")
    assert len(read_record(path).time_s) == 2


def test_day_numbers_called_seconds_are_refused_until_the_scale_is_given(tmp_path: Path) -> None:
    stamps = [f"{_day_number(moment):.8f}" for moment in MOMENTS]
    with pytest.raises(RecordError, match="looks like a day number of a spreadsheet; give --time-scale 86400"):
        _read(tmp_path, "time_s,T_in_C", stamps)
    record = _read(tmp_path, "time_s,T_in_C", stamps, time_scale=86400.0)
    assert np.diff(record.time_s) == pytest.approx([120.0] * 29, abs=0.01)


@pytest.mark.parametrize("stamps", [[f"{46_000 + k}" for k in range(30)], [f"{46_000 + k / 8}" for k in range(30)]])
def test_seconds_as_large_as_day_numbers_stay_seconds(tmp_path: Path, stamps: list[str]) -> None:
    assert _read(tmp_path, "time_s,T_in_C", stamps).time_s.tolist() == [float(stamp) for stamp in stamps]


def test_a_scale_is_that_of_the_rig_to_the_clock_of_the_record(tmp_path: Path) -> None:
    record = _read(tmp_path, "Date,T_in_C", _written("%Y-%m-%d %H:%M:%S"), time_scale=60.0)
    assert record.time_s[1] == 7200 and record.start == BEGIN
    assert _read(tmp_path, "time_min,T_in_C", ["0", "1"], time_scale=2.0).time_s[1] == 120


def test_a_time_column_is_taken_by_name(tmp_path: Path) -> None:
    stamps = [f"{1000 - k},{k}" for k in range(30)]
    assert _read(tmp_path, "time_s,sample,T_in_C", stamps, time_column="sample").time_s[-1] == 29
    two = _read(tmp_path, "d,c,T_in_C", _written("%Y-%m-%d,%H:%M:%S"), time_column="d,c")
    assert two.time_s[-1] == 29 * 120
    with pytest.raises(RecordError, match="has no column 'clock'; it has time_s, sample, T_in_C"):
        _read(tmp_path, "time_s,sample,T_in_C", stamps, time_column="clock")


def test_columns_of_dates_and_times_in_parquet_are_joined(tmp_path: Path) -> None:
    path = tmp_path / "typed.parquet"
    dates = pa.array([moment.date() for moment in MOMENTS], pa.date32())
    times = pa.array([moment.time() for moment in MOMENTS], pa.time64("us"))
    pq.write_table(pa.table({"Date": dates, "Time": times, "T_in_C": [20.0] * 30}), path)
    record = read_record(path)
    assert record.time_s[-1] == 29 * 120 and record.start == BEGIN


def _night(date: str, hours: list[int], zone: str = "") -> list[str]:
    return [f"{date} {hour:02}:{minute:02}:00{zone}" for hour in hours for minute in range(0, 60, 10)]


@pytest.mark.parametrize(
    ("date", "hours", "which"),
    [("2026-10-25", [0, 1, 2, 2, 3, 4], "back"), ("2026-03-29", [0, 1, 3, 4, 5, 6], "forward")],
)
def test_the_hour_of_the_night_when_clocks_are_changed_is_neither_lost_nor_won(
    tmp_path: Path, date: str, hours: list[int], which: str
) -> None:
    record = _read(tmp_path, "Date,T_in_C", _night(date, hours))
    assert record.time_s.tolist() == [600.0 * k for k in range(36)]
    assert any(f"local time on the night when clocks go {which} looks like line" in said for said in record.messages)


def test_such_a_step_on_another_day_or_with_a_zone_is_one_of_the_rows(tmp_path: Path) -> None:
    for stamps in (_night("2026-03-28", [0, 1, 3, 4, 5]), _night("2026-03-29", [0, 1, 3, 4, 5], "+00:00")):
        record = _read(tmp_path, "Date,T_in_C", stamps)
        assert np.diff(record.time_s).max() == 4200
    with pytest.raises(RecordError, match="split it"):
        _read(tmp_path, "Date,T_in_C", _night("2026-10-24", [0, 1, 2, 2, 3]))


NAMES: list[tuple[str, float]] = [
    ("Elapsed Time (min)", 60.0),
    ("time_us", 1e-6),
    ("hours", 3600.0),
    ("Run Time [s]", 1.0),
]


@pytest.mark.parametrize(("name", "scale"), NAMES)
def test_the_name_of_a_time_gives_its_unit(tmp_path: Path, name: str, scale: float) -> None:
    assert _read(tmp_path, f"{name},T_in_C", ["0", "1"]).time_s[1] == pytest.approx(scale)


@pytest.mark.parametrize("name", ["T_min", "T_h", "T1_s", "tank_s"])
def test_a_temperature_is_not_taken_for_a_time(tmp_path: Path, name: str) -> None:
    with pytest.raises(RecordError, match="has no column time_s"):
        _read(tmp_path, f"{name},T_in_C", ["0", "1"])


@pytest.mark.parametrize("make", [lambda k: 1e300, lambda k: -1e308 if k % 2 else 1e308])
def test_a_clock_that_cannot_be_is_refused(tmp_path: Path, make: Callable[[int], float]) -> None:
    with pytest.raises(RecordError, match="no readable time in column 'time_s'"):
        _read(tmp_path, "time_s,T_in_C", [repr(make(k)) for k in range(9)])
