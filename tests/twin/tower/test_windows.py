"""Novelty of an operating point: against those before it alone, with limits that hold what they say."""

from __future__ import annotations

import numpy as np

from twin.tower import novelty


def test_the_limit_holds_all_but_one_in_two_hundred_of_a_normal_plant() -> None:
    rng = np.random.default_rng(1)
    shape = np.linalg.cholesky(np.array([[9, 2, 0, 0], [2, 4, 0.1, 0], [0, 0.1, 0.04, 0], [0, 0, 0, 0.01]]))
    found = np.concatenate([novelty(20.0 + rng.normal(0.0, 1.0, (300, 4)) @ shape.T, [True] * 300) for _ in range(30)])
    found = found[np.isfinite(found)]
    assert 0.002 < np.mean(found > 1.0) < 0.012


def test_only_what_was_before_and_may_be_used_counts() -> None:
    x = np.random.default_rng(2).normal(0.0, 1.0, (60, 4))
    late = x.copy()
    late[40:] += 50.0
    np.testing.assert_allclose(novelty(late, [True] * 60)[:40], novelty(x, [True] * 60)[:40], rtol=1e-9)
    unused = [k < 30 for k in range(60)]
    assert (novelty(late, unused)[40:] > 5.0).all()  # a refused window makes nothing usual
    assert np.isnan(novelty(x, [True] * 60)[:8]).all() and np.isfinite(novelty(x, [True] * 60)[8:]).all()


def test_a_window_without_features_is_unknown_and_spoils_no_other() -> None:
    x = np.random.default_rng(4).normal(0.0, 1.0, (30, 4))
    holed = x.copy()
    holed[5] = np.nan
    found = novelty(holed, [True] * 30)
    assert np.isnan(found[5]) and np.isfinite(found[9:]).all()
