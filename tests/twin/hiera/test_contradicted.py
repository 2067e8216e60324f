"""A thermometer that the rest of the rig contradicts is left aside; what happens to the rig is not taken for that."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin.calibrators.hiera_unet.context_fit import contradicted
from twin.calibrators.hiera_unet.context_fit.contradicted import Doubt, reviewed, trusted, without
from twin.calibrators.hiera_unet.data.channels import table
from twin.calibrators.hiera_unet.data.features import Features
from twin.calibrators.hiera_unet.data.parameters import Deviations
from twin.calibrators.hiera_unet.data.series import STEP_S, ResampledSeries
from twin.kernel import simulate
from twin.twinfile import load

LOOP = load(Path(__file__).resolve().parents[3] / "profiles" / "twins" / "loop.toml")
FEATURES = Features(LOOP, table(LOOP), Deviations.of(LOOP))
TANK = LOOP.sensor_names.index("T_tank_C")
ONSET = 1200
"""Step at which something happens: an hour and forty minutes into the record."""


def record(
    steps: int = 1560, seed: int = 0, change: dict[str, float] | None = None, slow_K: float = 0.01
) -> ResampledSeries:
    """The loop under a changing load, `change` from ONSET on; readings with noise and an error that lasts."""
    rng = np.random.default_rng(seed)
    level = lambda low, high, every: np.repeat(rng.uniform(low, high, steps // every + 1), every)[:steps]  # noqa: E731
    time = STEP_S * np.arange(steps)
    inputs = np.column_stack([level(400, 900, 140), level(60, 100, 220), level(30, 90, 180), np.full(steps, 22.0)])
    clean = simulate(LOOP, time, inputs, np.array([35.0, 32.0, 29.0, 30.0]))
    if change is not None:
        after = LOOP.with_values({k: v * LOOP.parameters[k].value for k, v in change.items()})
        clean[ONSET:] = simulate(after, time[ONSET:], inputs[ONSET:], LOOP.initial_state(clean[ONSET]))
    slow = slow_K * np.sin(time[:, None] / 900.0 + np.arange(len(LOOP.sensors)))
    measured = clean + slow + 0.02 * rng.standard_normal(clean.shape)
    return ResampledSeries(time, inputs, measured, np.full(measured.shape, np.nan))


def off(series: ResampledSeries, sensor: int, by: Any, first: int = ONSET, last: int | None = None) -> ResampledSeries:
    """The same with a thermometer that reads off."""
    measured = series.measured.copy()
    measured[first:last, sensor] += by
    return ResampledSeries(series.time, series.inputs, measured, series.spread)


def follow(series: ResampledSeries, since: int = 600, every: int = 60) -> list[tuple[int, tuple[Doubt, ...]]]:
    """What is doubted at the end of every cycle."""
    doubts: tuple[Doubt, ...] = ()
    found = []
    for end in range(since, len(series) + 1, every):
        doubts = reviewed(FEATURES, series.part(0, end), (LOOP.values,), doubts)
        found.append((end, doubts))
    return found


@pytest.mark.parametrize("sensor", range(len(LOOP.sensors)))
@pytest.mark.parametrize("by", [-0.5, 0.8])
def test_a_thermometer_that_steps_is_doubted_within_two_cycles_from_the_moment_it_did(sensor: int, by: float) -> None:
    found = follow(off(record(), sensor, by))
    assert all(doubts == () for end, doubts in found if end <= ONSET)
    for _, doubts in [row for row in found if row[0] >= ONSET + 120]:
        (doubt,) = doubts
        assert doubt.sensor == sensor and doubt.off_K == pytest.approx(by, abs=0.06)
        assert abs(doubt.since_s - STEP_S * ONSET) <= 60.0


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"circuit.effectiveness_modules": 0.7},
        {"circuit.effectiveness_heater": 0.9},
        {"fins.UA_100": 0.4},
        {"fins.UA_100": 2.5},
        {"tank_loss.hA": 3.0},
        {"modules_loss.hA": 3.0},
        {"heater_power.factor": 0.9},
        {"circuit.factor": 0.8},
        {"fins.fan_exponent": 0.7},
    ],
    ids=str,
)
@pytest.mark.parametrize("seed", [0, 1])
def test_what_happens_to_the_rig_is_no_doubt_about_a_thermometer(change: dict[str, float], seed: int) -> None:
    assert all(doubts == () for _, doubts in follow(record(seed=seed, change=change), since=ONSET + 30, every=30))


def test_a_thermometer_that_reads_right_again_is_trusted_again() -> None:
    found = dict(follow(off(record(1800), TANK, 0.5, last=ONSET + 240)))
    assert found[ONSET + 120] and found[ONSET + 240]
    assert found[ONSET + 240 + contradicted.AGREEING] == ()


def test_a_drift_is_doubted_once_it_is_far_enough() -> None:
    steps = np.arange(1800 - ONSET)
    found = follow(off(record(1800), TANK, 1.0 * steps * STEP_S / 3600.0))
    first = next(end for end, doubts in found if doubts)
    assert ONSET + 60 <= first <= ONSET + 480 and {d.sensor for d in dict(found)[first]} == {TANK}


def test_a_twin_that_went_after_the_lie_is_held_against_what_it_was_before() -> None:
    series = off(record(), 0, 0.6).part(0, ONSET + 200)
    bent = LOOP.with_values({"heater_loss.hA": 0.05, "circuit.effectiveness_modules": 0.55, "fins.UA_100": 57.0}).values
    assert reviewed(FEATURES, series, (bent,), ()) == ()
    (doubt,) = reviewed(FEATURES, series, (bent, LOOP.values), ())
    assert doubt.sensor == 0
    assert reviewed(FEATURES, series, (bent, LOOP.values), (doubt,)) == (doubt,)


def test_never_more_than_half_of_the_thermometers_are_left_aside() -> None:
    series = record(2400)
    for sensor, first in enumerate((1200, 1500, 1800)):
        series = off(series, sensor, 0.6, first=first)
    assert max(len(doubts) for _, doubts in follow(series)) == 2


def test_a_record_too_short_to_tell_changes_nothing() -> None:
    known = (Doubt(TANK, 0.0, 0.4),)
    assert reviewed(FEATURES, record(200), (LOOP.values,), known) == known
    assert reviewed(FEATURES, record(200), (LOOP.values,), ()) == ()


def test_what_is_left_aside_is_missing_from_its_moment_on() -> None:
    series = record(400)
    doubt = Doubt(TANK, 500.0, 0.4)
    left = trusted(series, (doubt,))
    np.testing.assert_array_equal(np.isnan(left.measured[:, TANK]), series.time >= 500.0)
    np.testing.assert_array_equal(np.delete(left.measured, TANK, 1), np.delete(series.measured, TANK, 1))
    assert not np.isnan(series.measured).any() and without(series.time, series.measured, ()) is series.measured
    assert Doubt.restored(doubt.plain()) == doubt
    assert "T_tank_C has come to read 0.40 K more than the other thermometers" in doubt.sentence(LOOP)


def test_the_gain_of_a_response_is_that_of_least_squares() -> None:
    rng = np.random.default_rng(5)
    residual = rng.normal(size=(80, 3))
    residual[10:20, 1] = np.nan
    noise, shape = np.array([0.5, 1.0, 2.0]), rng.normal(size=(80, 3))
    squares = contradicted._CentredResiduals(residual, noise)
    times, gained = squares.explained(shape, -np.inf, np.inf)
    good = np.isfinite(residual)
    each = [np.flatnonzero(good[:, j]) for j in range(3)]
    weight = 1.0 / (noise * np.sqrt(contradicted.CORRELATED_STEPS))
    columns = np.concatenate([np.outer(np.repeat(weight[j], len(rows)), np.eye(3)[j]) for j, rows in enumerate(each)])
    own = np.concatenate([weight[j] * shape[rows, j] for j, rows in enumerate(each)])
    goal = np.concatenate([weight[j] * residual[rows, j] for j, rows in enumerate(each)])
    alone = goal - columns @ np.linalg.lstsq(columns, goal, rcond=None)[0]
    both = np.column_stack([columns, own])
    found = np.linalg.lstsq(both, goal, rcond=None)[0]
    assert times == pytest.approx(found[-1])
    assert gained == pytest.approx((alone**2).sum() - ((goal - both @ found) ** 2).sum())
