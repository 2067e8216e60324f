"""Intervals hold what they promise on windows that were not used to set them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from twin.calibrators.hiera_unet.data.windows import TARGET
from twin.calibrators.hiera_unet.model.config import HieraError
from twin.calibrators.hiera_unet.weights import conformal
from twin.calibrators.hiera_unet.weights.conformal import Factors, fit, one_a_window, quantile
from twin.calibrators.hiera_unet.weights.envelope import envelope, place


def errors(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors alike inside a window, scales that are wrong by a factor that hangs on the regime; scales and regimes."""
    bins = rng.integers(0, 2, count)
    level = rng.normal(size=(count, 1, 2))
    error = 0.7 * level + 0.3 * rng.normal(size=(count, 120, 2))
    scale = np.where(bins == 0, 0.2, 1.5)[:, None, None] * np.ones((count, 120, 2))
    return error, scale, bins


def test_coverage_on_unseen_windows_is_the_promised_one_in_every_regime() -> None:
    rng = np.random.default_rng(0)
    error, scale, bins = errors(rng, 2000)
    factors = fit(one_a_window(error, scale, rng), bins)
    error, scale, bins = errors(rng, 4000)
    inside = np.abs(error) <= factors.of(bins)[:, None, :] * scale
    for b in (0, 1):
        assert abs(inside[bins == b].mean() - 0.9) < 0.02
    assert abs(Factors.read(json.loads(json.dumps(factors.document()))).of(bins) - factors.of(bins)).max() == 0.0


def test_a_regime_with_few_windows_takes_the_factor_of_all() -> None:
    rng = np.random.default_rng(1)
    scores = np.abs(rng.normal(size=(200, 2)))
    bins = np.zeros(200, dtype=int)
    bins[:5] = 3
    factors = fit(scores, bins)
    assert 3 not in factors.binned and factors.counts == {0: 195, 3: 5}
    np.testing.assert_array_equal(factors.of(np.array([3, 7])), [factors.overall] * 2)


def test_too_few_windows_are_refused() -> None:
    with pytest.raises(HieraError, match="too few to calibrate 90% intervals"):
        fit(np.ones((8, 1)), np.zeros(8, dtype=int))


def test_scores_that_are_not_known_do_not_count() -> None:
    rng = np.random.default_rng(2)
    error, scale, _ = errors(rng, 50)
    error[:, :, 1] = np.nan
    error[:, 5:, 0] = np.nan
    scores = one_a_window(error, scale, rng)
    assert np.isfinite(scores[:, 0]).all() and np.isnan(scores[:, 1]).all()
    assert {float(s) for s in scores[:, 0]} <= {float(s) for s in (np.abs(error) / scale)[:, :5, 0].ravel()}


def test_crepes_gives_the_same_factors() -> None:
    pytest.importorskip("sklearn", reason="scikit-learn is not installed, which crepes needs")
    pytest.importorskip("crepes", reason="crepes is not installed: split conformal of our own is used")
    scores = np.abs(np.random.default_rng(3).normal(size=137))
    for confidence in (0.5, 0.8, 0.9, 0.95):
        np.testing.assert_allclose(conformal.by_crepes(scores, confidence), quantile(scores, confidence))


def test_the_envelope_holds_the_unseen_and_not_the_strange() -> None:
    rng = np.random.default_rng(4)
    mix = rng.normal(size=(20, 20))
    hull = envelope(rng.normal(size=(600, 20)) @ mix, rng.normal(size=(400, 20)) @ mix)
    assert (hull.distance(rng.normal(size=(1000, 20)) @ mix) > 1.0).mean() < 0.03
    assert (hull.distance(rng.normal(size=(100, 20)) @ mix * 3.0) > 1.0).mean() > 0.95


def test_a_place_is_that_of_the_context_whatever_is_known_of_the_target() -> None:
    rng = np.random.default_rng(0)
    x, m = rng.normal(size=(40, 1440, 3)), rng.random((40, 1440, 3)) > 0.3
    m[0, :, 1] = False
    found = place(np.where(m, x, 0.0), m)
    hidden, other = m.copy(), x.copy()
    hidden[:, -TARGET:] = False
    other[:, -TARGET:] = 9.0
    np.testing.assert_array_equal(place(other, hidden), found)
    assert np.isnan(found[0, [1, 4]]).all() and np.isfinite(found[1:]).all()
    np.testing.assert_allclose(found[1, 3], x[1, :-TARGET, 0][m[1, :-TARGET, 0]].std())
    hull = envelope(found, found)
    gone = found.copy()
    gone[:, 2] = np.nan
    assert (hull.distance(gone) <= hull.distance(found) + 0.2).all() and hull.distance(found + 9.0).min() > 1.0
