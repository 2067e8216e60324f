"""Minutes from samples with gaps, jitter, repeats and changes of clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.historian.made_station import local_stamps
from twin.historian.defects.clocks import Shift, corrected, repeated_hours
from twin.historian.minutes import How, held_minutes, mean_minutes, minute_edges, staleness_min
from twin.historian.tags import Array, Series, Tag

TAG = Tag("T", "degC", "water_inlet_temperature", 1, 120.0)
T0 = 1_700_000_040.0 - 1_700_000_040.0 % 60.0


def _series(time_s: Array, value: Array, quality: int = 192) -> Series:
    time_s = np.asarray(time_s, dtype=np.float64)
    return Series(TAG, time_s, np.asarray(value, dtype=np.float64), np.full(len(time_s), quality, dtype=np.int16))


samples = st.lists(
    st.tuples(st.floats(0.0, 7200.0), st.floats(-50.0, 50.0), st.sampled_from([192, 192, 192, 64, 0])),
    min_size=2,
    max_size=80,
)


@given(samples, st.floats(60.0, 3600.0))
@settings(max_examples=150, deadline=None)
def test_minutes_lie_between_the_samples_around_them(rows: list[tuple[float, float, int]], limit: float) -> None:
    time_s, value, quality = (np.array(column) for column in zip(*rows, strict=True))
    usable = Series(TAG, time_s + T0, value, quality.astype(np.int16)).usable()
    edges = minute_edges(T0, T0 + 7200.0)
    minutes, how = mean_minutes(usable, edges, limit)
    assert np.array_equal(np.isfinite(minutes), how != How.MISSING)
    for k in np.flatnonzero(np.isfinite(minutes)):
        low = max(int(np.searchsorted(usable.time_s, edges[k], side="right")) - 1, 0)
        high = int(np.searchsorted(usable.time_s, edges[k + 1], side="left"))
        around = usable.value[low : high + 1]
        assert around.min() - 1e-6 <= minutes[k] <= around.max() + 1e-6


@given(samples, st.floats(180.0, 3600.0))
@settings(max_examples=100, deadline=None)
def test_nothing_is_filled_across_a_long_gap_or_bad_quality(rows: list[tuple[float, float, int]], limit: float) -> None:
    time_s, value, quality = (np.array(column) for column in zip(*rows, strict=True))
    raw = Series(TAG, time_s + T0, value, quality.astype(np.int16))
    usable = raw.usable()
    edges = minute_edges(T0, T0 + 7200.0)
    minutes, _ = mean_minutes(usable, edges, limit)
    known = usable.time_s
    for k in np.flatnonzero(np.isfinite(minutes)):
        # Some interval that is short and without a bad sample covers half of the minute, alone or with others.
        covered = 0.0
        for a, b in zip(known[:-1], known[1:], strict=True):
            bad = (raw.time_s > a) & (raw.time_s < b) & ~raw.good
            if b - a <= limit and not bad.any():
                covered += max(min(b, edges[k + 1]) - max(a, edges[k]), 0.0)
        assert covered >= 29.9


@given(
    st.lists(st.floats(0.0, 3600.0), min_size=3, max_size=60, unique=True), st.floats(-5.0, 5.0), st.floats(-0.01, 0.01)
)
@settings(max_examples=100, deadline=None)
def test_a_straight_line_is_kept_whatever_the_jitter(times: list[float], level: float, slope: float) -> None:
    time_s = np.unique(np.round(np.sort(times), 3))
    minutes, _ = mean_minutes(_series(time_s + T0, level + slope * time_s), minute_edges(T0, T0 + 3600.0), 1e9)
    middle = np.arange(60) * 60.0 + 30.0
    inside = (middle - 30.0 >= time_s[0]) & (middle + 30.0 <= time_s[-1])
    assert np.allclose(minutes[inside], (level + slope * middle)[inside], atol=1e-5)


@given(samples)
@settings(max_examples=100, deadline=None)
def test_samples_that_were_stored_again_change_nothing(rows: list[tuple[float, float, int]]) -> None:
    time_s, value, quality = (np.array(column) for column in zip(*rows, strict=True))
    _, unique = np.unique(time_s, return_index=True)
    once = Series(TAG, time_s[unique] + T0, value[unique], quality[unique].astype(np.int16))
    twice = once.rows(np.repeat(np.arange(len(unique)), 2))
    edges = minute_edges(T0, T0 + 7200.0)
    for one, again in zip(
        mean_minutes(once.usable(), edges, 600.0), mean_minutes(twice.usable(), edges, 600.0), strict=True
    ):
        assert np.array_equal(one, again, equal_nan=True)


def test_the_origin_of_a_minute_is_marked() -> None:
    series = _series(T0 + np.array([5.0, 130.0, 1000.0, 1500.0]), np.array([1.0, 2.0, 3.0, 4.0]))
    _, how = mean_minutes(series, minute_edges(T0, T0 + 1500.0), 900.0)
    assert how[0] == How.MEASURED and how[1] == How.INTERPOLATED and how[2] == How.MEASURED
    assert how[8] == How.BY_EXCEPTION
    _, strict = mean_minutes(series, minute_edges(T0, T0 + 1500.0), 180.0)
    assert strict[1] == How.INTERPOLATED and strict[8] == How.MISSING


def test_the_mean_is_weighted_by_time() -> None:
    series = _series(T0 + np.array([0.0, 50.0, 60.0]), np.array([0.0, 0.0, 12.0]))
    minutes, _ = mean_minutes(series, minute_edges(T0, T0 + 60.0), 180.0)
    assert minutes[0] == pytest.approx(1.0)  # 10 s of a ramp to 12


def test_a_command_keeps_its_value_and_is_not_interpolated() -> None:
    series = _series(T0 + np.array([0.0, 600.0]), np.array([20.0, 80.0]))
    minutes, how = held_minutes(series, minute_edges(T0, T0 + 660.0), 900.0)
    assert minutes.tolist() == [20.0] * 10 + [80.0]
    assert how[5] == How.HELD and how[0] == How.MEASURED


def test_a_command_is_unknown_where_its_next_sample_is_too_late() -> None:
    series = _series(T0 + np.array([0.0, 6000.0]), np.array([20.0, 80.0]))
    minutes, _ = held_minutes(series, minute_edges(T0, T0 + 6060.0), 900.0)
    assert np.isnan(minutes[:100]).all() and minutes[100] == 80.0


def test_a_command_is_not_held_across_bad_quality() -> None:
    raw = Series(
        TAG, T0 + np.array([0.0, 300.0, 600.0]), np.array([20.0, 99.0, 80.0]), np.array([192, 0, 192], np.int16)
    )
    minutes, _ = held_minutes(raw.usable(), minute_edges(T0, T0 + 660.0), 3600.0)
    assert np.isnan(minutes[1:10]).all() and minutes[10] == 80.0


def test_staleness_counts_from_the_last_sample() -> None:
    age = staleness_min(_series(T0 + np.array([70.0, 200.0]), np.array([1.0, 2.0])), minute_edges(T0, T0 + 300.0))
    assert np.isnan(age[0])
    assert age[1:].tolist() == pytest.approx([50 / 60, 110 / 60, 40 / 60, 100 / 60])


@given(
    st.integers(0, 365 * 24),
    st.integers(24, 24 * 30),
    st.sampled_from(["Europe/Madrid", "America/Chicago", "Asia/Kolkata"]),
)
@settings(max_examples=40, deadline=None)
def test_local_stamps_come_back_to_utc_but_for_the_hour_that_comes_twice(start: int, hours: int, zone: str) -> None:
    true = 1_650_000_000.0 + 3600.0 * start + np.arange(0.0, 3600.0 * hours, 733.0)
    stamps = local_stamps(true, zone)
    order = np.argsort(stamps, kind="stable")
    moved = corrected(_series(stamps[order], true[order]), Shift(zone))
    doubled = repeated_hours(float(true[0]), float(true[-1]) + 7200.0, zone)
    assert np.all(np.diff(moved.time_s) >= 0.0)
    assert np.allclose(moved.time_s, moved.value)  # the value is the true time
    lost = [t for t in true if not np.any(np.isclose(moved.time_s, t))]
    assert all(any(low - 3600.0 <= t <= high + 3600.0 for low, high in doubled) for t in lost)


def test_a_hole_breaks_the_interval_that_it_lies_in_only() -> None:
    series = replace(_series([0.0, 100.0, 200.0, 300.0], [0.0, 1.0, 2.0, 3.0]), holes=np.array([[120.0, 180.0]]))
    assert series.broken().tolist() == [False, True, False]
    found = series.at(np.array([50.0, 100.0, 150.0, 200.0, 250.0]), 1e9)
    assert np.isnan(found[2]) and found[[0, 1, 3, 4]].tolist() == [0.5, 1.0, 2.0, 2.5]
