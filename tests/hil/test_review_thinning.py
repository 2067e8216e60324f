"""A review's file leaves out what its curves do not need, and puts twins beside one another that answer late."""

from __future__ import annotations

import numpy as np
import pytest

from hil.review.batches.residuals import LATE_TICKS, Residuals
from hil.review.batches.thinning import GROUP, needed_rows


def drawn(time_s: np.ndarray, values: np.ndarray, tolerance: float) -> tuple[np.ndarray, int]:
    found = needed_rows(time_s, values[:, None], tolerance)
    return np.interp(time_s, time_s[found], values[found]), int(found.sum())


def test_a_line_is_told_by_the_first_rows_of_its_groups():
    time_s = np.arange(10.0 * GROUP + 5.0)
    found = needed_rows(time_s, (2.0 * time_s + 1.0)[:, None], 1e-9)
    assert np.flatnonzero(found[: 10 * GROUP]).tolist() == list(range(0, 10 * GROUP, GROUP))
    assert found[10 * GROUP :].all()


@pytest.mark.parametrize("tolerance", [1e-6, 1e-3, 0.05])
def test_straight_lines_between_kept_rows_miss_nothing_by_more_than_the_tolerance(tolerance):
    time_s = np.cumsum(np.random.default_rng(3).uniform(0.2, 2.0, 4000))
    values = 40.0 + np.sin(time_s / 300.0) + np.where(time_s > 2000.0, 3.0, 0.0)
    seen, count = drawn(time_s, values, tolerance)
    assert np.abs(seen - values).max() <= tolerance * (1.0 + 1e-9)
    assert count < len(time_s)
    spike = values.copy()
    spike[1234] += 1.0
    assert np.abs(drawn(time_s, spike, tolerance)[0] - spike).max() <= tolerance * (1.0 + 1e-9)


def test_a_gap_keeps_its_rows():
    time_s, values = np.arange(20.0 * GROUP), np.full((20 * GROUP, 1), 5.0)
    values[100:103] = np.nan
    found = needed_rows(time_s, values, 0.1)
    assert found[100:103].all() and found[99] and found[103]


def test_twins_that_answer_at_different_times_share_rows():
    waiting = Residuals(("static", "network"), 1)
    ticks = np.arange(10)
    waiting.add("static", ticks, ticks * 1.0, ticks[:, None] + 0.5)
    waiting.add("network", ticks[:4], ticks[:4] * 1.0, ticks[:4, None] - 0.5)
    time_s, residual = waiting.take(last=False)
    assert time_s.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert (residual[:, :, 0] == np.column_stack([ticks[:4] + 0.5, ticks[:4] - 0.5])).all()
    time_s, residual = waiting.take(last=True)
    assert time_s.tolist() == [4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
    assert np.isfinite(residual[:, 0]).all() and np.isnan(residual[:, 1]).all()


def test_a_twin_that_has_stopped_is_not_waited_for():
    waiting = Residuals(("static", "network"), 1)
    ticks = np.arange(LATE_TICKS + 10)
    waiting.add("network", ticks[:5], ticks[:5] * 1.0, np.zeros((5, 1)))
    waiting.add("static", ticks, ticks * 1.0, np.zeros((len(ticks), 1)))
    time_s, residual = waiting.take(last=False)
    assert len(time_s) == len(ticks) and np.isnan(residual[5:, 1]).all()
    waiting.add("network", ticks[5:], ticks[5:] * 1.0, np.zeros((len(ticks) - 5, 1)))
    assert len(waiting.take(last=True)[0]) == 0
