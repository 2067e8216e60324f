"""Dates with seconds of the day, or with hours, minutes and seconds in columns of their own."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.record.reader import Record, RecordError, read_record

BEGIN = datetime.datetime(2026, 3, 4, 23, 0)
ROWS = 150


def read(
    tmp_path: Path, heading: str, cells: Callable[[datetime.datetime, float, int], str], step_s: float = 30.0
) -> Record:
    rows = []
    for row in range(ROWS):
        now = BEGIN + datetime.timedelta(seconds=step_s * row)
        of_day = (now - now.replace(hour=0, minute=0, second=0)).total_seconds()
        rows.append(f"{cells(now, of_day, row)},{20 + row / 100:.2f}\n")
    path = tmp_path / "counted.csv"
    path.write_text(f"{heading},T_tank_C\n" + "".join(rows), encoding="utf-8")
    return read_record(path)


@pytest.mark.parametrize(
    ("heading", "cells"),
    [
        ("Date,Seconds", lambda now, s, k: f"{now:%Y-%m-%d},{s:.0f}"),
        ("Time (s),Datum", lambda now, s, k: f"{s:.1f},{now:%d.%m.%Y}"),
        ("Date,SecondsOfDay", lambda now, s, k: f"{now:%Y%m%d},{s:.0f}"),
        ("Date,Seconds since midnight", lambda now, s, k: f"{now:%-m/%-d/%Y},{s:.3f}"),
        ("Date,Time_ms", lambda now, s, k: f"{now:%Y-%m-%d},{1000 * s:.0f}"),
        ("Date,Hours", lambda now, s, k: f"{now:%Y-%m-%d},{s / 3600:.8f}"),
        ("Date,Hour,Minute,Second", lambda now, s, k: f"{now:%d.%m.%Y},{now.hour},{now.minute},{now.second}"),
        ("Date,hh,mm,ss", lambda now, s, k: f"{now:%Y/%m/%d,%H,%M,%S}"),
        ("Date,Seconds", lambda now, s, k: f"{(now.date() - datetime.date(1899, 12, 30)).days},{s:.0f}"),
        ("Year,DOY,Seconds", lambda now, s, k: f"{now:%Y},{now:%j},{s:.0f}"),
        ("Year,Month,Day,Hour", lambda now, s, k: f"{now:%Y,%m,%d},{s / 3600:.8f}"),
        ("Year,DOY", lambda now, s, k: f"{now:%Y},{int(f'{now:%j}') + s / 86400:.9f}"),
    ],
)
def test_dates_and_counts_within_the_day_are_one_time_over_midnight(tmp_path, heading, cells):
    record = read(tmp_path, heading, cells)
    np.testing.assert_allclose(record.time_s, 30.0 * np.arange(ROWS), atol=0.01)
    assert record.start is not None
    assert abs(record.start - BEGIN.replace(tzinfo=datetime.UTC)) < datetime.timedelta(seconds=0.1)


def test_the_newest_row_may_stand_first(tmp_path):
    record = read(tmp_path, "Date,Seconds", lambda now, s, k: f"{now:%Y-%m-%d},{s:.0f}", step_s=-30.0)
    np.testing.assert_allclose(np.diff(record.time_s), 30.0)
    assert record.columns["T_tank_C"][0] == pytest.approx(20 + (ROWS - 1) / 100)


@pytest.mark.parametrize("days", [True, False], ids=["over midnight", "on one day"])
def test_a_count_that_runs_on_is_a_time_since_the_beginning(tmp_path, days):
    record = read(tmp_path, "Date,Seconds", lambda now, s, k: f"{now if days else BEGIN:%Y-%m-%d},{30 * k}")
    np.testing.assert_array_equal(record.time_s, 30.0 * np.arange(ROWS))
    assert record.start is None
    assert "column 'Seconds' is taken for time_s, in seconds" in record.messages


def test_a_total_of_each_day_is_no_time_of_day(tmp_path):
    record = read(tmp_path, "Date,Minutes", lambda now, s, k: f"{now:%Y-%m-%d},{37 * k % 900}", step_s=86400.0)
    np.testing.assert_array_equal(np.diff(record.time_s), 86400.0)
    assert "Minutes" in record.columns


def test_minutes_above_an_hour_beside_hours_are_no_clock(tmp_path):
    with pytest.raises(RecordError, match="stand at a time that another row has too"):
        read(tmp_path, "Date,Hour,Minute", lambda now, s, k: f"{now:%Y-%m-%d},{now.hour},{now.minute + 40}")


def test_an_infinite_count_is_no_time(tmp_path):
    record = read(tmp_path, "Date,Seconds", lambda now, s, k: f"{now:%Y-%m-%d}," + ("inf" if k == 7 else f"{s:.0f}"))
    assert len(record.time_s) == ROWS - 1
    assert any("1 row has no readable time" in said for said in record.messages)
