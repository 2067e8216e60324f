"""Jumps of a clock in a record: clocks that were set, times of another unit, single broken times, other epochs."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

from hil.record.raw import ReadingOptions, RecordError
from hil.record.reader import read_record, write_record

N = 60
START = 1_772_618_400


def read(tmp_path, times, name="time_s", **choice):
    path = tmp_path / "record.csv"
    rows = "".join(f"{time},{20.0 + 0.1 * k:.1f}\n" for k, time in enumerate(times))
    path.write_text(f"{name},T_tank_C\n{rows}", encoding="utf-8")
    return read_record(path, choice=ReadingOptions(**choice))


@pytest.mark.parametrize(
    ("first", "name"), [(START, "timestamp"), (30, "time_s")], ids=["since 1970", "from the beginning"]
)
def test_times_that_turn_into_milliseconds_are_refused_at_their_line(tmp_path, first, name):
    times = [first + 30 * k for k in range(N)]
    times[40:] = [1000 * time for time in times[40:]]
    with pytest.raises(RecordError, match=r"line 42: from here on the times are 1000 times as large"):
        read(tmp_path, times, name)


def test_many_rows_before_the_clock_was_set_are_refused_at_the_line_where_it_was(tmp_path):
    moments = [datetime.datetime(1970, 1, 1) + datetime.timedelta(seconds=30 * k) for k in range(20)]
    moments += [datetime.datetime(2026, 3, 4) + datetime.timedelta(seconds=30 * k) for k in range(20, N)]
    with pytest.raises(RecordError, match=r"line 22: the time goes on by 56.2 years"):
        read(tmp_path, [m.isoformat() for m in moments], "timestamp")


@pytest.mark.parametrize("name", ["time_s", "time_min", "timestamp"])
def test_a_step_of_more_than_a_year_between_many_rows_is_refused_in_every_kind_of_time(tmp_path, name):
    first, per_s = (START, 1.0) if name == "timestamp" else (0, 1.0 / 60.0 if name == "time_min" else 1.0)
    times = [first + (30 * k + (400 * 86_400 if k >= N // 2 else 0)) * per_s for k in range(N)]
    with pytest.raises(RecordError, match=r"line 32: the time goes on by 1.1 years"):
        read(tmp_path, times, name)


def test_two_rows_before_the_clock_was_set_are_left_out_and_the_record_begins_after_them(tmp_path):
    moments = [datetime.datetime(2026, 3, 4) + datetime.timedelta(seconds=30 * k) for k in range(N)]
    moments[:2] = [datetime.datetime(2000, 1, 1), datetime.datetime(2000, 1, 1, 0, 0, 30)]
    record = read(tmp_path, [m.isoformat() for m in moments], "timestamp")
    assert len(record.time_s) == N - 2
    assert record.time_s[0] == 0.0
    assert record.start == datetime.datetime(2026, 3, 4, 0, 1, tzinfo=datetime.UTC)
    assert any("2 rows lie 26.2 years from all other times" in said and "line 2" in said for said in record.messages)


@pytest.mark.parametrize("at", [0, 30, N - 1])
def test_one_broken_time_far_ahead_is_left_out_wherever_it_stands(tmp_path, at):
    times = [30 * k for k in range(N)]
    times[at] += 1_000_000
    record = read(tmp_path, times)
    assert len(record.time_s) == N - 1
    assert np.ptp(record.time_s) <= 30 * N
    assert any(f"the first is line {at + 2}" in said for said in record.messages)
    assert not any("time goes back" in said for said in record.messages)


@pytest.mark.parametrize("gap", [300, 5 * 30 * N, 86_400])
def test_a_gap_between_many_rows_stays_a_gap(tmp_path, gap):
    times = [30 * k + (gap if k >= N // 2 else 0) for k in range(N)]
    record = read(tmp_path, times)
    assert len(record.time_s) == N


def test_a_resumed_run_keeps_the_rows_after_its_gap(tmp_path):
    path = tmp_path / "record.csv"
    rows = "".join(f"{k if k < N else k + 1_000_000},{20 + k},{1 if k < N else 2}\n" for k in range(N + 2))
    path.write_text(f"time_s,T_tank_C,segment\n{rows}", encoding="utf-8")
    record = read_record(path)
    assert len(record.time_s) == N + 2
    write_record(record, tmp_path / "record.parquet")
    assert len(read_record(tmp_path / "record.parquet").time_s) == N + 2


@pytest.mark.parametrize("name", ["time", "time_s"])
def test_milliseconds_under_the_name_of_seconds_are_questioned_with_the_remedy(tmp_path, name):
    times = [1234 + 30_000 * k for k in range(N)]
    said = [m for m in read(tmp_path, times, name).messages if "--time-scale 0.001" in m]
    assert len(said) == 1 and said[0].endswith("reads them so")
    record = read(tmp_path, times, name, time_scale=0.001)
    assert record.period_s == pytest.approx(30.0)
    assert not any("milliseconds?" in m for m in record.messages)


@pytest.mark.parametrize("period", [10, 30, 60, 900, 1800, 3600])
def test_usual_periods_in_seconds_are_not_questioned(tmp_path, period):
    assert not any("milliseconds" in m for m in read(tmp_path, [period * k for k in range(N)]).messages)


def test_a_column_of_millis_alone_is_named_in_the_remedy(tmp_path):
    times = [30_000 * k for k in range(N)]
    with pytest.raises(RecordError, match=r"--time-column millis --time-scale 0\.001"):
        read(tmp_path, times, "millis")
    assert read(tmp_path, times, "millis", time_column="millis", time_scale=0.001).period_s == pytest.approx(30.0)


def test_seconds_since_1904_are_questioned_as_a_beginning_in_the_future(tmp_path):
    said = read(tmp_path, [START + 2_082_844_800 + 30 * k for k in range(N)], "timestamp").messages
    assert any("begins in the future, on 2092-03-04" in m and "2026-03-04" in m for m in said)
    assert not any("future" in m for m in read(tmp_path, [START + 30 * k for k in range(N)], "timestamp").messages)
