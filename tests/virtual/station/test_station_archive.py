"""The plant's archive: what is kept rebuilds the scans within the deviation."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.virtual.tower.recording.archive import archived, exceptions, scan_times, swinging_door


@pytest.mark.parametrize("seed", range(4))
def test_lines_between_kept_samples_stay_within_the_deviation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(50.0, 200.0, 800))
    value = np.cumsum(rng.normal(0.0, 0.05, 800))
    kept = swinging_door(time, value, 0.2, 3600.0)
    rebuilt = np.interp(time, time[kept], value[kept])
    assert np.abs(rebuilt - value).max() < 0.4
    assert kept.sum() < 0.5 * len(time)


def test_a_value_that_stands_still_is_sent_after_the_longest_time_alone() -> None:
    time = np.arange(0.0, 7200.0, 60.0)
    sent = exceptions(time, np.full(len(time), 3.0), 0.1, 1800.0)
    assert np.diff(time[sent]).tolist() == [1800.0] * 3


def test_a_step_keeps_the_scan_before_it() -> None:
    time = np.arange(0.0, 6000.0, 60.0)
    value = np.where(time < 3000.0, 1.0, 5.0)
    rows = archived(time, value, 0.5, 36000.0)
    assert {2940.0, 3000.0} <= set(time[rows])


def test_scans_have_a_phase_and_jitter_and_stay_in_order() -> None:
    time = scan_times(0.0, 86400.0, 120.0, np.random.default_rng(3))
    gaps = np.diff(time)
    assert (gaps > 0.0).all()
    assert gaps.std() > 1.0
    assert gaps.mean() == pytest.approx(120.0, rel=0.01)
