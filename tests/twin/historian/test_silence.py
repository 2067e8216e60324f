"""Gaps of communication: found in a group whose few silences are gaps for some per cent."""

from __future__ import annotations

import numpy as np

from twin.historian.defects.silence import Group, communication_gaps
from twin.historian.tags import Series, Tag

DAY_S = 86400.0


def test_gaps_are_found_in_a_group_that_is_seldom_silent_by_itself() -> None:
    rng = np.random.default_rng(1)
    gaps = [(10.0 * DAY_S, 3.6 * 3600.0), (20.0 * DAY_S, 2.0 * 3600.0), (30.0 * DAY_S, 5.0 * 3600.0)]
    series = []
    for k in range(10):
        # At night one reading in seven minutes a tag, so that the group is silent for five minutes now and then.
        time_s = np.cumsum(rng.exponential(440.0, int(40.0 * DAY_S / 440.0)))
        for start, length in gaps:
            time_s = time_s[(time_s < start) | (time_s > start + length)]
        tag = Tag(f"X{k}", "kW", "fan_power", 1, 120.0)
        value = rng.standard_normal(len(time_s))
        series.append(Series(tag, time_s, value, np.full(len(time_s), 192, dtype=np.int16)))
    names = tuple(one.tag.name for one in series)
    minutes = np.arange(0.0, 40.0 * DAY_S, 60.0)
    other = Tag("Y", "%", "other", None, 60.0)
    plain = Series(other, minutes, np.zeros(len(minutes)), np.full(len(minutes), 192, dtype=np.int16))
    found = communication_gaps([*series, plain], [Group(names)], {})
    assert [(round(one.start_s / 3600.0), round((one.end_s - one.start_s) / 3600.0, 0)) for one in found] == [
        (round(start / 3600.0), round(length / 3600.0, 0)) for start, length in gaps
    ]
