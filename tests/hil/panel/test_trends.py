"""Courses of the panel: mean, least and greatest of each bin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.panel.trends import Trends


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, 400), st.one_of(st.none(), st.integers(-50, 50))), min_size=1, max_size=60),
    st.lists(st.integers(1, 20), max_size=6),
)
def test_a_course_keeps_mean_least_and_greatest_of_each_bin_however_it_comes(points, sizes):
    points = sorted(points, key=lambda point: point[0])
    time_s = np.array([at for at, _ in points], dtype=float)
    values = np.array([[np.nan if value is None else value] for _, value in points], dtype=float)
    course, first = Trends(["x"], 1.0, bins=8), 0
    for size in [*sizes, len(points)]:
        course.add(time_s[first : first + size], [0], values[first : first + size])
        first += size
    document = course.document()
    assert len(document["time_s"]) <= 8 and document["bin_s"] * 8 > time_s[-1]
    bins: dict[int, list[float]] = {}
    for at, value in points:
        if value is not None:
            bins.setdefault(int(at // document["bin_s"]), []).append(value)
    assert document["time_s"] == [(k + 0.5) * document["bin_s"] for k in sorted(bins)]
    series = document["series"]["x"]
    for k, members in enumerate(bins[key] for key in sorted(bins)):
        assert series["mean"][k] == pytest.approx(np.mean(members), rel=1e-4, abs=1e-9)
        assert (series["low"][k], series["high"][k]) == (min(members), max(members))
