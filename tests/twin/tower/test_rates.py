"""Rates of a loss that change within a record: sizes by marginal likelihood, and none where a rate lasts."""

from __future__ import annotations

import numpy as np
import pytest

from twin.tower.air import Array
from twin.tower.change_detection import changing_rate
from twin.tower.estimates import (
    CHANGED_D,
    DAY_S,
    RATE_SD,
    WALK,
    Estimate,
    rate_covariance,
    time_grid,
    walk_precision,
    walk_variance,
)
from twin.tower.model import SLOW

EDGES = time_grid(0.0, 50 * DAY_S)
DAYS = 0.5 * (EDGES[:-1] + EDGES[1:]) / DAY_S
NOISE = 0.02
"""Standard deviation of a fill and of a wetted share by the readings of a half day."""


def late(days: float, rate: float) -> Array:
    """Loss that begins after a number of days."""
    return -rate * np.maximum(DAYS - days, 0.0)


def smoothed(truth: dict[str, Array], rates: dict[str, float], seed: int = 0) -> Estimate:
    """Posterior of deviations that are read directly, without constants."""
    rng, k, s = np.random.default_rng(seed), len(DAYS), len(SLOW)
    slow, covariance = np.zeros((k, s)), np.zeros((k * s, k * s))
    steps = np.diff(np.eye(k), axis=0)
    for j, name in enumerate(SLOW):
        inner, drift = walk_precision(EDGES, name, (), 0.0, rates.get(name, 0.0))
        read = truth.get(name, np.zeros(k)) + rng.normal(0.0, NOISE, k)
        own = np.linalg.inv(steps.T @ inner @ steps + np.eye(k) / NOISE**2)
        slow[:, j] = own @ (steps.T @ inner @ drift + read / NOISE**2)
        covariance[np.ix_(np.arange(k) * s + j, np.arange(k) * s + j)] = own
    of_blocks = np.zeros(k)
    return Estimate(
        EDGES, slow, np.zeros(0), covariance, (0.1, 0.03), of_blocks, of_blocks, np.arange(k), np.zeros((k, s)), 1.0,
        of_blocks, of_blocks,
    )  # fmt: skip


def test_a_rate_that_lasts_is_common_to_all_increments_and_one_that_changes_is_forgotten() -> None:
    days = np.diff(DAYS)
    variance, drift = walk_variance(EDGES, "fill", ())
    precision, mean = walk_precision(EDGES, "fill", (), 0.0, 0.004)
    lasting = np.linalg.inv(precision) - np.diag(variance) - rate_covariance(EDGES, 0.004)
    assert np.allclose(mean, drift)
    assert np.allclose(lasting, RATE_SD["fill"] ** 2 * np.outer(days, days), rtol=1e-4)
    changing = rate_covariance(EDGES, 0.004)
    assert changing[0, 2 * int(CHANGED_D)] == pytest.approx(np.exp(-1.0) * (0.004 * days[0]) ** 2)


@pytest.mark.parametrize("name", ["fill", "uniformity"])
def test_a_loss_that_begins_after_quiet_weeks_frees_the_rate_of_its_deviation(name: str) -> None:
    truth = {name: late(20.0, 0.005)}
    before = smoothed(truth, {})
    rates = changing_rate(before, ())
    assert list(rates) == [name] and 0.0015 < rates[name] < 0.009
    after = smoothed(truth, rates)
    j = SLOW.index(name)
    error = [np.abs(p.slow[:, j] - truth[name]).mean() for p in (before, after)]
    assert error[1] < 0.7 * error[0] and abs(after.slow[-1, j] - truth[name][-1]) < 2.0 * after.sd()[-1, j]


def test_no_rate_is_free_beyond_one_that_lasts_where_the_loss_lasts() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        walk = {name: np.cumsum(rng.normal(0.0, WALK[name] * 0.5**0.5, len(DAYS))) for name in SLOW}
        walk["fill"] = walk["fill"] - 0.0009 * DAYS
        walk["uniformity"] = walk["uniformity"] - 0.0003 * DAYS
        assert not any(rate > 1.1 * RATE_SD["fill"] for rate in changing_rate(smoothed(walk, {}, seed), ()).values())
