"""What is believed if few parameters have moved agrees with the sums that it stands for."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.calibrators.hiera_unet.context_fit.sparse import Likelihood, Usual, posterior

P = 4


def data(seed: int, rows: int = 6, noise: float = 0.3, truth: np.ndarray | None = None) -> Likelihood:
    """Of linear measurements of deviations, by default of none that moved."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(rows, P)) / noise
    true = np.zeros(P) if truth is None else truth
    measured = jacobian @ true + rng.normal(size=rows)
    return Likelihood(jacobian.T @ jacobian, jacobian.T @ measured)


def usual(chance: float = 0.1, slab: float = 0.4, spike: float = 0.02) -> Usual:
    return Usual(np.full(P, chance), np.full(P, slab), np.full(P, spike))


def by_hand(likely: Likelihood, law: Usual, most: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, variance and chance, set after set, each by its own covariance."""
    weights, means, squares, sets = [], [], [], []
    for moved in product((False, True), repeat=P):
        if sum(moved) > most:
            continue
        prior = np.where(moved, law.slab, law.spike) ** 2
        covariance = np.linalg.inv(likely.information + np.diag(1.0 / prior))
        mean = covariance @ likely.pull
        weight = np.prod(np.where(moved, law.chance, 1.0 - law.chance))
        weight *= np.sqrt(np.linalg.det(covariance) / np.prod(prior)) * np.exp(0.5 * likely.pull @ mean)
        weights.append(weight)
        means.append(mean)
        squares.append(np.diag(covariance) + mean**2)
        sets.append(moved)
    share = np.array(weights) / np.sum(weights)
    mean = share @ np.array(means)
    return mean, share @ np.array(squares) - mean**2, share @ np.array(sets)


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10_000),
    st.integers(1, P),
    st.floats(0.02, 0.5),
    st.floats(0.1, 1.0),
    st.floats(0.002, 0.08),
    st.integers(0, 12),
)
def test_it_is_the_sum_over_all_sets(seed: int, most: int, chance: float, slab: float, spike: float, rows: int) -> None:
    likely, law = data(seed, rows), usual(chance, slab, spike)
    found = posterior(likely, law, most)
    mean, variance, share = by_hand(likely, law, most)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.sd**2, variance, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(found.chance, share, rtol=1e-6, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.05, 1.0))
def test_if_slab_and_spike_are_one_it_is_ridge(seed: int, width: float) -> None:
    likely = data(seed)
    found = posterior(likely, usual(slab=width, spike=width), P)
    covariance = np.linalg.inv(likely.information + np.eye(P) / width**2)
    np.testing.assert_allclose(found.mean, covariance @ likely.pull, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.sd, np.sqrt(np.diag(covariance)), rtol=1e-8)


def test_if_all_have_surely_moved_it_is_ridge() -> None:
    likely = data(3)
    found = posterior(likely, usual(chance=1.0 - 1e-9), P)
    covariance = np.linalg.inv(likely.information + np.eye(P) / 0.4**2)
    np.testing.assert_allclose(found.mean, covariance @ likely.pull, rtol=1e-5)
    np.testing.assert_allclose(found.chance, 1.0, atol=1e-5)


def test_without_data_the_prior_comes_back() -> None:
    law = usual(chance=0.1)
    found = posterior(Likelihood.nothing(P), law, P)
    np.testing.assert_allclose(found.chance, law.chance)
    np.testing.assert_allclose(found.sd**2, 0.1 * law.slab**2 + 0.9 * law.spike**2)
    assert (found.mean == 0.0).all()
    assert (posterior(Likelihood.nothing(P), law, 2).chance < law.chance).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, P - 1), st.floats(0.3, 1.0), st.booleans())
def test_the_one_that_moved_is_found(seed: int, which: int, size: float, up: bool) -> None:
    truth = np.zeros(P)
    truth[which] = size if up else -size
    found = posterior(data(seed, rows=60, noise=0.1, truth=truth), usual(), 2)
    assert found.chance[which] > 0.99 and abs(found.mean[which] - truth[which]) < 0.1
    assert np.abs(np.delete(found.mean, which)).max() < 0.1


def test_what_cannot_be_told_apart_is_shared_and_unsure() -> None:
    information = 1e3 * np.ones((2, 2))
    found = posterior(Likelihood(information, np.full(2, 400.0)), Usual(*(np.full(2, v) for v in (0.1, 0.4, 0.01))), 2)
    np.testing.assert_allclose(found.chance[0], found.chance[1])
    assert found.chance.sum() == pytest.approx(1.0, abs=0.2) and (found.sd > 0.1).all()
    assert found.mean.sum() == pytest.approx(0.4, abs=0.05)


def test_it_is_the_same_whatever_the_order_of_parameters() -> None:
    likely, order = data(5), np.array([2, 0, 3, 1])
    law = Usual(np.array([0.1, 0.2, 0.05, 0.3]), np.array([0.4, 0.2, 0.3, 0.5]), np.full(P, 0.02))
    turned = Likelihood(likely.information[np.ix_(order, order)], likely.pull[order])
    one, other = posterior(likely, law), posterior(turned, Usual(law.chance[order], law.slab[order], law.spike[order]))
    np.testing.assert_allclose(one.mean[order], other.mean)
    np.testing.assert_allclose(one.chance[order], other.chance)


def test_a_likelihood_is_plain_numbers() -> None:
    likely = data(1)
    again = Likelihood.of_plain(likely.plain(), P)
    np.testing.assert_array_equal(again.information, likely.information)
    np.testing.assert_array_equal(again.pull, likely.pull)
