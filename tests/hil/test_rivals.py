"""What can be had without a network: the evidence shrunk, and networks that are shown the wrong record."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed: the network calibrator is left out")

from hil.training.baselines import Shrinkage, estimates, judged, noisy, shuffled  # noqa: E402
from tests.twin.hiera import fake  # noqa: E402


def drawn(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Truth, estimate and standard error (N, 1): one in five moved, and errors are three times what is said."""
    rng = np.random.default_rng(seed)
    true = np.where(rng.random((count, 1)) < 0.2, 0.4 * rng.normal(size=(count, 1)), 0.0)
    return true, true + 0.12 * rng.normal(size=true.shape), np.full(true.shape, 0.04)


def test_shrinkage_learns_how_wide_errors_are_and_halves_them_where_nothing_moved() -> None:
    true, estimate, sd = drawn(2000, 0)
    laws = Shrinkage.learned(estimate, sd, true, np.ones(true.shape, dtype=bool))
    true, estimate, sd = drawn(2000, 1)
    mean, spread = laws.of(estimate, sd)
    assert np.mean((mean - true) ** 2) < 0.6 * np.mean((estimate - true) ** 2)
    assert np.abs(mean[true == 0.0]).mean() < 0.5 * np.abs(estimate[true == 0.0]).mean()
    assert (spread > 0.0).all()


def test_what_has_too_few_labels_stays_as_it_is() -> None:
    true, estimate, sd = drawn(10, 0)
    mean, _ = Shrinkage.learned(estimate, sd, true, np.ones(true.shape, dtype=bool)).of(estimate, sd)
    np.testing.assert_allclose(mean, estimate, rtol=1e-2)


def test_scores_count_known_labels_alone_and_moved_ones_apart() -> None:
    true = np.array([[0.0, np.nan], [0.5, 0.2]])
    known = np.array([[True, True], [True, False]])
    found = judged(np.array([[0.1, 9.0], [0.3, 9.0]]), np.full((2, 2), 0.1), true, known)
    assert found["parameters"] == pytest.approx(0.15) and found["moved"] == pytest.approx(0.2)
    assert found["inside90"] == pytest.approx(0.5) and found["width90"] == pytest.approx(0.329)
    assert found["winkler90"] == pytest.approx(0.329 + 0.5 * 20.0 * (0.2 - 0.1645))
    assert set(judged(true, np.ones((2, 2)), true, np.zeros((2, 2), dtype=bool)).values()) == {None}


def test_channels_are_taken_away_and_the_evidence_stays() -> None:
    windows = fake.windows(6)
    for other in (shuffled(windows), noisy(windows)):
        np.testing.assert_array_equal(other.meta, windows.meta)
        assert other.x.dtype == np.float32 and not np.array_equal(other.x, windows.x)
    width = noisy(windows).x[windows.m].std()
    assert 0.5 < width / windows.x[windows.m].std() < 2.0


def test_every_rival_of_a_network_has_a_mean_and_a_spread() -> None:
    windows = fake.windows(40)
    found = estimates(fake.config(), windows, windows)
    assert all(mean.shape == sd.shape == (40, 2) and (sd > 0.0).all() for mean, sd in found.values())
