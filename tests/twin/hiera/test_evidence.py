"""The classical fit of a context: finds what changed, says how well, and what it cannot tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.hiera.records import NETWORK, deviation, features, made
from twin.calibrators.hiera_unet.context_fit.evidence import (
    LARGEST_LOG_CONDITION,
    believed,
    estimate,
    fitted_by,
    identifiable,
    tell,
    tokens,
)
from twin.calibrators.hiera_unet.data.parameters import FACTOR, LOSS, REACH, SUM, Deviations
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET

N = 1500
DEVIATIONS = Deviations.of(NETWORK)
P = len(DEVIATIONS)
POWER, UA, TANK = (DEVIATIONS.ids.index(i) for i in ("modules_power.power", "fins.UA_100", "tank_loss.hA"))


def fitted(series):
    frame = features().frame(series, N, NETWORK.values)
    return frame, estimate(features(), frame, NETWORK.values)


def test_deviations_are_undone_by_their_inverse_and_theta_zero_is_the_twin():
    rng = np.random.default_rng(0)
    theta = rng.uniform(-0.9, 0.9, (20, P))
    values = DEVIATIONS.values(theta, NETWORK.values)
    inside = (values > DEVIATIONS.lower) & (values < DEVIATIONS.upper)
    assert np.abs(DEVIATIONS.theta(values, NETWORK.values) - theta)[inside].max() < 1e-9
    np.testing.assert_array_equal(DEVIATIONS.full(np.zeros(P), NETWORK.values), NETWORK.values)


def test_laws_follow_the_specification():
    law = dict(zip(DEVIATIONS.ids, DEVIATIONS.law.tolist(), strict=True))
    assert law["fins.UA_100"] == FACTOR and law["tank_loss.hA"] == LOSS and law["modules_power.power"] == SUM
    other = Deviations.of(NETWORK.with_values({"tank_loss.hA": 40.0, "fins.UA_100": 5.0}))
    assert (other.law == DEVIATIONS.law).all() and (other.scale == DEVIATIONS.scale).all()


def test_a_healthy_rig_gives_no_deviation_within_its_errors():
    _, found = fitted(made(N))
    sure = found.told & (found.sd < 0.1)
    assert sure.sum() >= 4
    assert (np.abs(found.theta[sure]) < 4.0 * found.sd[sure]).all()
    assert found.steps == CONTEXT - TARGET


@pytest.mark.parametrize(
    ("name", "size"), [("modules_power.power", 0.3), ("fins.UA_100", -0.25), ("tank_loss.hA", 0.3)]
)
def test_a_change_that_was_there_from_the_start_is_found(name, size):
    _, found = fitted(made(N, deviation(**{name.replace(".", "__"): size})))
    k = DEVIATIONS.ids.index(name)
    assert found.theta[k] == pytest.approx(size, abs=max(4.0 * found.sd[k], 0.02))
    assert found.sd[k] < 0.05


def test_a_change_in_the_middle_is_followed_with_the_data_since():
    onset = N - TARGET - 240
    _, found = fitted(made(N, deviation(modules_power__power=0.4), onset=onset))
    assert found.steps <= 360
    assert found.theta[POWER] == pytest.approx(0.4, abs=0.05)


def test_the_target_is_not_used():
    series = made(N)
    altered = series.measured.copy()
    altered[N - TARGET :] += 5.0
    _, found = fitted(series)
    _, other = fitted(replace(series, measured=altered))
    np.testing.assert_array_equal(found.theta, other.theta)
    np.testing.assert_array_equal(found.tokens(DEVIATIONS), other.tokens(DEVIATIONS))


def test_without_data_the_prior_comes_back():
    series = made(N)
    _, found = fitted(replace(series, measured=np.full_like(series.measured, np.nan)))
    assert (found.theta == 0.0).all() and (found.sd == DEVIATIONS.prior_sd).all()
    assert not found.told.any()
    assert found.tokens(DEVIATIONS).size == tokens(P)
    assert found.tokens(DEVIATIONS)[-1] == LARGEST_LOG_CONDITION


def test_conduction_beside_the_flow_is_never_told():
    """Its effect hides behind advection, as in the paper's own tables."""
    _, found = fitted(made(N))
    assert not found.told[[k for k, i in enumerate(DEVIATIONS.ids) if i.endswith("resistance")]].any()


def test_a_label_right_after_a_change_does_not_count():
    frame, _ = fitted(made(N))
    long, short = (identifiable(features(), frame, NETWORK.values, since) for since in (0, CONTEXT - 30))
    assert long[[POWER, UA]].all()
    assert not short.any()


def test_two_parameters_with_one_effect_are_not_told_apart():
    j = np.random.default_rng(0).normal(size=(500, 3))
    j = np.column_stack([j[:, 0], j[:, 0] + 1e-5 * j[:, 1], j[:, 2], np.zeros((500, 0))])
    told, condition = tell(j.T @ j, np.full(3, 0.4))
    assert told.tolist().count(True) == 2 and told[2]
    assert condition > 80.0


def test_estimates_stay_inside_the_reach():
    _, found = fitted(made(N, deviation(modules_power__power=REACH, fins__UA_100=-0.9)))
    assert (np.abs(found.theta) <= REACH + 1e-9).all()
    assert np.isfinite(found.tokens(DEVIATIONS)).all()


def test_what_a_fit_leaves_is_noise_since_the_change_and_missing_before():
    onset = N - TARGET - 240
    frame, found = fitted(made(N, deviation(modules_power__power=0.4), onset=onset))
    names = [list(features().table.names).index(f"fitted_{s}") for s in NETWORK.sensor_names]
    assert not frame.m[:, names].any()
    told = features().explained(frame, NETWORK.values, found.theta, found.steps)
    first = CONTEXT - TARGET - found.steps
    assert not told.m[:first, names].any() and told.m[first:, names].all()
    unfitted = np.abs(frame.x[first:, [list(features().table.names).index("residual_T_modules_C")]]).mean()
    assert np.abs(told.x[first:, names]).mean() < 0.5 * unfitted
    others = [k for k in range(frame.x.shape[1]) if k not in names]
    np.testing.assert_array_equal(told.x[:, others], frame.x[:, others])


def test_what_is_kept_tells_what_was_fitted():
    _, found = fitted(made(N, deviation(fins__UA_100=-0.2)))
    theta, steps = fitted_by(found.kept(), P)
    np.testing.assert_allclose(theta, found.theta)
    assert steps == found.steps


def test_one_parameter_that_moved_is_believed_and_the_others_stay():
    _, found = fitted(made(N, deviation(fins__UA_100=-0.2)))
    few = believed(found.kept(), DEVIATIONS)
    assert few.chance[UA] > 0.9 and few.mean[UA] == pytest.approx(-0.2, abs=0.02)
    others = np.delete(np.arange(P), UA)
    assert few.chance[others].max() < 0.5
    assert np.abs(few.mean[others]).max() < 0.02


def test_without_data_few_are_believed_to_have_moved():
    series = made(N)
    _, found = fitted(replace(series, measured=np.full_like(series.measured, np.nan)))
    few = believed(found.kept(), DEVIATIONS)
    assert (few.mean == 0.0).all() and (few.chance < 0.2).all()
