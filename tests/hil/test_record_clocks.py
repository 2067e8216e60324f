"""Clocks of a record that contradict themselves or each other: refused, or the one that has dates."""

from __future__ import annotations

import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.record.reader import Record, RecordError, read_record


def _read(tmp_path: Path, name: str, stamps: list[str]) -> Record:
    path = tmp_path / "clock.csv"
    path.write_text(f"{name},T_in_C\n" + "".join(f"{s},{20 + k}\n" for k, s in enumerate(stamps)), encoding="utf-8")
    return read_record(path)


def _twelve(minutes: range, pattern: str) -> list[str]:
    return [pattern.format((m // 60 - 1) % 12 + 1, m % 60) for m in minutes]


@pytest.mark.parametrize("pattern", ["2025-07-09 {:02}:{:02}:00", "07/19/2025 {}:{:02}", "{:02}:{:02}:30"])
def test_a_clock_of_twelve_hours_without_am_and_pm_is_refused(tmp_path: Path, pattern: str) -> None:
    with pytest.raises(RecordError, match=r"steps back by twelve hours.*write hours from 00 to 23, or AM and PM"):
        _read(tmp_path, "Time", _twelve(range(600, 900, 15), pattern))


def test_rows_of_a_full_clock_that_go_back_are_sorted(tmp_path: Path) -> None:
    stamps = [f"2025-07-09 {hour:02}:{minute:02}:00" for hour in (12, 13, 1, 2) for minute in range(0, 60, 15)]
    assert any("rows sorted" in said for said in _read(tmp_path, "Time", stamps).messages)


def test_four_fields_are_read_by_those_that_roll_over(tmp_path: Path) -> None:
    days = [f"{h // 24:02}:{h % 24:02}:00:00" for h in range(40)]
    assert np.diff(_read(tmp_path, "Elapsed", days).time_s).tolist() == [3600.0] * 39
    clock = [f"00:{c // 6000:02}:{c // 100 % 60:02}:{c % 100:02}" for c in range(0, 900, 25)]
    assert np.diff(_read(tmp_path, "Elapsed", clock).time_s) == pytest.approx([0.25] * 35)


def test_four_fields_that_may_be_days_or_hours_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"'00:03:00:00' may be dd:hh:mm:ss or hh:mm:ss and hundredths"):
        _read(tmp_path, "Elapsed", [f"00:{k:02}:00:00" for k in range(3, 20)])


def test_dates_overrule_a_time_without_a_unit_that_they_contradict(tmp_path: Path) -> None:
    record = _read(
        tmp_path, "time,timestamp", [f"{k / 4},2025-07-09 08:{15 * k // 60:02}:{15 * k % 60:02}" for k in range(40)]
    )
    assert record.time_s[-1] == 39 * 15 and record.start is not None
    assert any("column 'time' without a unit spans" in said for said in record.messages)
    assert list(record.columns) == ["T_in_C"]


def test_a_time_with_a_unit_is_kept_with_a_remark_where_dates_contradict_it(tmp_path: Path) -> None:
    record = _read(tmp_path, "time_s,timestamp", [f"{60 * k},2025-07-09T08:00:{k:02}Z" for k in range(40)])
    assert record.time_s[-1] == 39 * 60
    assert any("--time-column timestamp takes the dates" in said for said in record.messages)


def test_dates_that_agree_are_left_aside_without_a_remark(tmp_path: Path) -> None:
    record = _read(tmp_path, "time,timestamp", [f"{k},2025-07-09T08:00:{k:02}Z" for k in range(40)])
    assert record.time_s[-1] == 39 and record.start is None


@pytest.mark.parametrize("kind", ["timestamp", "time", "day numbers"])
def test_a_clock_of_twelve_hours_in_a_typed_column_is_refused(tmp_path: Path, kind: str) -> None:
    minutes = [(m // 60 - 1) % 12 * 60 + 60 + m % 60 for m in range(600, 900, 15)]
    column = {
        "timestamp": pa.array([1_752_883_200 + 60 * m for m in minutes], pa.timestamp("s")),
        "time": pa.array([60 * m for m in minutes], pa.time32("s")),
        "day numbers": pa.array([45_857 + m / 1440 for m in minutes]),
    }[kind]
    path = tmp_path / "clock.parquet"
    pq.write_table(pa.table({"Date": column, "T_in_C": [20.0 + k for k in range(20)]}), path)
    with pytest.raises(RecordError, match=r"steps back by twelve hours.*write hours from 00 to 23, or AM and PM"):
        read_record(path)


@pytest.mark.parametrize("hours", [1, 2, 3])
@pytest.mark.parametrize(("first", "which"), [("2025-10-25 12:00", "back"), ("2025-03-29 12:00", "forward")])
def test_a_change_of_clocks_between_rows_hours_apart_is_taken_out(
    tmp_path: Path, hours: int, first: str, which: str
) -> None:
    zone = ZoneInfo("Europe/Berlin")
    begin = datetime.datetime.fromisoformat(first).replace(tzinfo=datetime.UTC)
    moments = [begin + datetime.timedelta(hours=hours * k) for k in range(40)]
    record = _read(tmp_path, "Time", [f"{m.astimezone(zone):%Y-%m-%d %H:%M}" for m in moments])
    assert np.diff(record.time_s).tolist() == [3600.0 * hours] * 39
    assert any(f"clocks go {which}" in said for said in record.messages)


def test_rows_an_hour_apart_with_other_gaps_and_repeats_keep_their_times(tmp_path: Path) -> None:
    begin = datetime.datetime(2025, 3, 29, 12)
    rows = [k for k in range(60) if k not in (14, 30, 31)]  # 02:00 on the Sunday, and two more
    record = _read(tmp_path, "Time", [f"{begin + datetime.timedelta(hours=k):%Y-%m-%d %H:%M}" for k in rows if k != 40])
    assert record.time_s[-1] == 59 * 3600
    assert not any("clocks go" in said for said in record.messages)


def test_a_column_called_zeit_with_large_seconds_is_in_seconds(tmp_path: Path) -> None:
    record = _read(tmp_path, "Zeit", [f"{20_000 + 100 * k}" for k in range(200)])
    assert record.time_s[-1] - record.time_s[0] == 19_900
