"""The filter: its estimate of every sample, its parameters, and that it neither diverges nor forgets."""

import json

import numpy as np
import pytest

from tests.twin.conftest import START, drive
from twin.calibrators import make_calibrator
from twin.calibrators.assimilate import assimilate
from twin.calibrators.base import SampleFilter
from twin.calibrators.kalman import BoundedTransform, KalmanFilter
from twin.gauss_newton import Scaling
from twin.kernel import simulate
from twin.network import Network
from twin.tracking import TwinTracker

Record = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def record(net: Network, change: dict[str, float] | None = None, onset: int = 1800, n: int = 5400) -> Record:
    """Stamps, inputs, measured, and what was really there."""
    onset = min(onset, n - 1)
    t, u = drive(n)
    before = simulate(net, t[: onset + 1], u[: onset + 1], START)
    after = simulate(net.with_values(change or {}), t[onset:], u[onset:], before[-1])
    truth = np.vstack([before[:-1], after])
    return t, u, truth + np.random.default_rng(0).normal(0.0, 1.0, truth.shape) * net.sigma, truth


def test_only_the_filter_follows_samples(loop: Network) -> None:
    assert isinstance(make_calibrator("kalman", loop), SampleFilter)
    assert not isinstance(make_calibrator("pso", loop), SampleFilter)
    t, u, y, _ = record(loop, n=700)
    assert TwinTracker(loop, "least_squares").push(t, u, y).filtered is None


def test_the_filtered_readings_are_better_than_the_thermometers_and_know_how_good(loop: Network) -> None:
    t, u, y, truth = record(loop)
    update = TwinTracker(loop, "kalman").push(t, u, y)
    assert update.filtered is not None
    assert update.spread is not None
    error, later = update.filtered - truth, slice(600, None)
    assert (np.sqrt(np.mean(error[later] ** 2, axis=0)) < 0.3 * loop.sigma).all()
    share = np.mean(np.abs(error[later]) < 2.0 * update.spread[later])
    assert 0.85 < share <= 1.0


def test_tracked_stays_a_prediction(loop: Network) -> None:
    t, u, y, _ = record(loop, n=1800)
    other = y.copy()
    other[1200:] += 5.0
    a, b = TwinTracker(loop, "kalman").push(t, u, y), TwinTracker(loop, "kalman").push(t, u, other)
    assert np.array_equal(a.tracked, b.tracked)
    assert a.filtered is not None
    assert b.filtered is not None
    assert not np.array_equal(a.filtered[1200:], b.filtered[1200:])


@pytest.mark.parametrize("tunables", ["paper4", "nine", "twelve"])
def test_does_not_diverge(loop: Network, tunables: str) -> None:
    """A naive joint filter does with nine and with twelve: its RMSE was 0.54 and 1.19 K."""
    t, u, y, _ = record(loop, {"fins.UA_100": 70.0, "radiator_to_tank.resistance": 0.5}, n=9000)
    update = TwinTracker(loop, "kalman", tunables=tunables).push(t, u, y)
    floor = float(np.sqrt(np.mean(loop.sigma**2)))
    assert all(c.error_K < 1.1 * floor for c in update.calibrations[4:])
    assert all(c.error_before_K < 1.5 * floor for c in update.calibrations[4:])


@pytest.mark.parametrize("change", [{"modules_power.power": 180.0}, {"tank_loss.hA": 9.0}, {"fins.UA_100": 40.0}])
def test_recovers_within_one_window(loop: Network, change: dict[str, float]) -> None:
    t, u, y, _ = record(loop, change)
    done = TwinTracker(loop, "kalman").push(t, u, y).calibrations
    assert done[3].error_before_K > 0.1
    assert all(c.error_before_K < 0.1 for c in done[4:])


def test_masked_readings_gaps_and_uneven_steps(loop: Network) -> None:
    t, u, y, truth = record(loop)
    rng = np.random.default_rng(1)
    keep = np.sort(rng.choice(t.size, t.size // 4, replace=False))
    keep = keep[(keep < 2000) | (keep > 2700)]
    y[rng.random(y.shape) < 0.2] = np.nan
    update = TwinTracker(loop, "kalman").push(t[keep], u[keep], y[keep])
    assert update.filtered is not None
    later = keep > 3300
    # a step of the power between two samples is seen late, so not every sample can be right
    assert np.quantile(np.abs(update.filtered - truth[keep])[later], 0.98) < 0.05
    assert np.isfinite(update.filtered).all()


def test_a_saved_filter_goes_on(loop: Network) -> None:
    t, u, y, _ = record(loop, n=2000)
    one = TwinTracker(loop, "kalman")
    whole = one.push(t, u, y)
    first, second = TwinTracker(loop, "kalman"), TwinTracker(loop, "kalman")
    first.push(t[:1111], u[:1111], y[:1111])
    second.restore(json.loads(json.dumps(first.state(), allow_nan=False)))
    rest = second.push(t[1111:], u[1111:], y[1111:])
    assert whole.filtered is not None
    assert rest.filtered is not None
    assert np.array_equal(whole.filtered[1111:], rest.filtered)
    assert np.array_equal(whole.tracked[1111:], rest.tracked)
    assert second.values == one.values


def test_bounds_by_transformation(loop: Network) -> None:
    scaling = Scaling.of(loop, loop.tunables("nine"))
    bounded = BoundedTransform(scaling)
    z = scaling.to_z(loop.values[scaling.index])
    assert np.allclose(bounded.to_z(bounded.to_w(z)), z)
    for w in (-1e6, 1e6):
        values = scaling.to_values(bounded.to_z(np.full(9, w)))
        assert ((values >= scaling.lower) & (values <= scaling.upper)).all()


def test_covariance_comes_with_the_numbers(loop: Network) -> None:
    t, u, y, _ = record(loop, n=1300)
    done = TwinTracker(loop, KalmanFilter(loop, "nine")).push(t, u, y).calibrations[-1]
    assert done.covariance is not None
    assert np.linalg.eigvalsh(done.covariance / np.outer(*[np.sqrt(np.diag(done.covariance))] * 2)).min() > -1e-9
    assert any("comes from earlier windows" in flag for flag in done.flags)


def test_a_reading_that_is_not_finite_is_no_reading() -> None:
    given = [np.random.default_rng(0).normal(0.0, 1.0, shape) for shape in ((6, 2, 3), (6, 2), (6, 2))]
    answers = []
    for missing in (np.nan, np.inf, -np.inf):
        jacobian, predicted, measured = (a.copy() for a in given)
        measured[2, 1] = missing
        estimate, covariance = np.zeros(3), np.eye(3)
        out = np.empty((6, 2)), np.empty((6, 2))
        found = assimilate(jacobian, predicted, measured, np.ones(2), estimate, covariance, *out)
        answers.append((found, estimate.tolist(), covariance.tolist()))
    assert answers[0] == answers[1] == answers[2] and answers[0][0][1] == 11
