"""Clocks of a store that were set wrong for some hours, as the order of storing shows them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.historian.made_station import clean_store
from twin.historian.stamps import with_clock_steps_undone
from twin.historian.tags import Series

HOUR_S = 3600.0


@pytest.fixture(scope="module")
def clean() -> list[Series]:
    return clean_store(np.random.default_rng(8), 6.0)


def off(one: Series, by_h: float, since_h: float, until_h: float) -> Series:
    """The tag with a clock that is off by some hours for a time, in the order of storing."""
    hours = (one.time_s - one.time_s[0]) / HOUR_S
    return replace(one, time_s=one.time_s + np.where((hours >= since_h) & (hours < until_h), by_h * HOUR_S, 0.0))


@pytest.mark.parametrize(("by_h", "since_h", "until_h"), [(-2.0, 50.0, 62.0), (3.0, 30.0, 41.5), (-26.0, 60.0, 61.0)])
def test_stamps_of_a_clock_that_was_set_wrong_for_hours_are_moved_back(
    clean: list[Series], by_h: float, since_h: float, until_h: float
) -> None:
    found, (defect,) = with_clock_steps_undone([off(one, by_h, since_h, until_h) for one in clean])
    assert (defect.kind, defect.repair) == ("clock_offset", "shifted to UTC")
    begin = min(float(one.time_s[0]) for one in clean)
    assert (defect.start_s - begin) / HOUR_S == pytest.approx(since_h, abs=0.5)
    assert (defect.end_s - begin) / HOUR_S == pytest.approx(until_h, abs=0.5)
    for one, right in zip(found, clean, strict=True):
        if one.tag.name in defect.tags:
            assert np.abs(one.time_s - right.time_s).max() <= 180.0, one.tag.name
    assert len(defect.tags) > 0.8 * len(clean)


def test_a_tag_with_long_intervals_is_moved_with_the_others(clean: list[Series]) -> None:
    rare = clean[0].rows(np.arange(0, len(clean[0].time_s), 12))
    rare = replace(rare, tag=replace(rare.tag, name="RARE"))
    found, (defect,) = with_clock_steps_undone([off(one, -2.0, 50.0, 62.0) for one in [*clean, rare]])
    assert "RARE" in defect.tags
    assert (np.diff(found[-1].time_s) > 0.0).all()


def test_what_is_no_setting_of_the_clock_stays(clean: list[Series]) -> None:
    summer = [off(one, -1.0, 50.0, 1e9) for one in clean]
    few = [off(one, -2.0, 50.0, 62.0) if k < 3 else one for k, one in enumerate(clean)]
    for series in (clean, summer, few):
        found, defects = with_clock_steps_undone(series)
        assert defects == [] and all(a is b for a, b in zip(found, series, strict=True))
    assert with_clock_steps_undone([]) == ([], [])
