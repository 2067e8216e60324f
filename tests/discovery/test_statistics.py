"""The noise that goes with what moves, the threshold against chance, and blocks of time left out."""

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, Bench
from twin.discovery.diagnosis import Fold
from twin.discovery.effects.shapes import Shape
from twin.discovery.engine import diagnose
from twin.discovery.evidence.part import Part
from twin.discovery.healthy.basis import Columns, basis
from twin.discovery.records.grid import on_grid
from twin.discovery.records.noise import CAUTION, bands, learn
from twin.discovery.refit.fitting import fit
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import holds, validate
from twin.discovery.scoring.null import Null
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry, able_to_begin

SIGMA, STEP_S = np.array([0.02, 0.03]), 10.0


def _moving(n: int, size: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Readings (n, 2) that move by `size`, and a residual with a twentieth of that beside the white noise."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.normal(0.0, 1.0, (n // 30 + 1, 2)), 30, axis=0)[:n]
    slow = np.cumsum(steps - steps.mean(axis=0), axis=0) / 30.0
    readings = 30.0 + size * slow
    return readings, 0.05 * (readings - readings.mean(axis=0)) + rng.normal(0.0, SIGMA, (n, 2))


@pytest.mark.parametrize("size", [0.25, 1.0, 3.0])
def test_structure_is_expected_to_follow_what_moves(size: float) -> None:
    readings, residual = _moving(3600, 1.0, 1)
    learned = learn(residual, SIGMA, STEP_S, readings)
    now, left = _moving(5000, size, 2)
    expected = learned.where_moved(now, STEP_S)
    white = expected.whiten(left)
    band = bands(len(white), STEP_S)
    for b in range(1, 5):
        power = CAUTION[b] * float((white[band == b] ** 2).mean())
        assert 0.4 < power < 2.5, (b, power)


@pytest.mark.parametrize("follows", [True, False])
def test_a_calm_record_has_less_error_only_where_the_calm_parts_of_the_healthy_one_have(follows: bool) -> None:
    """Of the healthy record the last three quarters are calm, as they are where a rig warms up and then runs on."""
    readings, residual = _moving(3600, 1.0, 1)
    calm = np.where(np.arange(3600) < 900, 1.0, 0.1)[:, None]
    moved = 30.0 + calm * (readings - 30.0)
    error = calm * (residual - residual.mean(axis=0)) if follows else residual
    white = np.random.default_rng(3).normal(0.0, SIGMA, (3600, 2))
    learned = learn(error + white, SIGMA, STEP_S, moved)
    assert (learned.follows == 1.0) is follows
    now, _ = _moving(3600, 0.1, 2)
    expected = learned.where_moved(now, STEP_S)
    same = learned.where_moved(moved, STEP_S)
    assert (expected.sd[1:3] < 0.8 * same.sd[1:3]).all() == follows
    assert learned.at_step(20.0).follows == learned.follows


def test_what_hardly_moves_still_has_the_noise_of_its_thermometers() -> None:
    readings, residual = _moving(3600, 1.0, 1)
    expected = learn(residual, SIGMA, STEP_S, readings).where_moved(np.full((3600, 2), 30.0), STEP_S)
    assert (expected.sd >= SIGMA - 1e-12).all()
    # Without the readings there is nothing to go by.
    bare = learn(residual, SIGMA, STEP_S)
    assert bare.where_moved(readings, STEP_S) is bare


def test_the_threshold_is_what_noise_seldom_reaches() -> None:
    null = Null(np.sort(np.random.default_rng(0).gumbel(3.5, 0.3, 400)))
    assert null.quantile(0.05) < null.quantile(0.01) < null.quantile(0.001)
    assert null.family_wise(null.quantile(0.01)) == pytest.approx(0.01, rel=1e-6)
    assert null.quantile(0.01) == pytest.approx(3.5 - 0.3 * np.log(-np.log(0.99)), abs=0.15)


def test_blocks_left_out_speak_for_what_is_there_and_against_what_is_not(pair: Bench, pair_healthy: Columns) -> None:
    heated = pair.with_element("heat", {"kind": "heat_source", "node": "tank", "power": 150.0})
    real = diagnose(pair.network, pair.record(24.0, changed=heated, onset_h=4.0), pair_healthy)
    assert holds(real.folds) and all(f.gain > 0.0 for f in real.folds)
    # What ended again, taken for something that stays: it gains where it is and loses where it is not.
    ended = pair.record(24.0, changed=heated, onset_h=4.0, until_h=11.0)
    grid = on_grid(pair.network, ended.time_s, ended.inputs, ended.measured)
    known = basis(pair.network, pair_healthy, grid)
    state = known.probe.first_state(grid)
    run = known.probe.run(grid, state)
    score_test = ScoreTest(known.probe, grid, state, run, known.noise, known.prior)
    law = next(
        w for w in known.book.laws(grid, run) if (w.candidate.kind, w.candidate.where) == ("heat_source", "tank")
    )
    entry = Entry(law, Shape("step", 4.0 * HOUR), np.empty(0), 150.0, 1.0, 0.0)
    model = Model.of(known.probe, (entry,))
    assert not holds(validate(score_test, model, fit(score_test, model, state)))


def test_a_thermometer_that_errs_from_the_beginning_says_nothing_of_a_volume(
    pair: Bench, pair_healthy: Columns
) -> None:
    """Were first readings right to a kelvin, an error of four would have to begin later; a volume may be there."""
    record = pair.record(6.0, seed=3)
    grid = on_grid(pair.network, record.time_s, record.inputs, record.measured)
    known = basis(pair.network, pair_healthy, grid)
    moved = np.zeros(len(known.prior.mean))
    moved[known.probe.q :] = 4.0
    assert 0.5 * float(moved @ known.prior.precision @ moved) < 1.0


def test_a_block_that_says_nothing_is_not_asked() -> None:
    assert holds(()) and holds((Fold(0.0, 1.0, 10, 0.5),))
    assert holds((Fold(0.0, 1.0, 10, 0.5), Fold(1.0, 2.0, 10, 40.0)))
    assert not holds((Fold(0.0, 1.0, 10, -30.0), Fold(1.0, 2.0, 10, 40.0)))
    assert not holds(tuple(Fold(0.0, 1.0, 10, g) for g in (-15.0, 40.0, 40.0, 4.0)))
    assert holds(tuple(Fold(0.0, 1.0, 10, g) for g in (-9.0, 21.0, 7.0)))  # as chance does to a weak one


def test_a_faint_effect_may_have_begun_at_more_times_than_a_strong_one(pair: Bench, pair_healthy: Columns) -> None:
    onset_s, spans = 5.0 * HOUR, []
    for power in (1.0, 100.0):
        record = pair.record(12.0, changed=pair.with_values(modules_power__power=power), onset_h=5.0)
        grid = on_grid(pair.network, record.time_s, record.inputs, record.measured)
        part = Part.of(basis(pair.network, pair_healthy, grid), grid)
        heat = next(e for e in part.scanned if e.label == ("heat_source", "modules", "constant"))
        first_s, last_s = able_to_begin(part.score_test, heat, np.zeros(0))
        assert first_s - part.score_test.step_s <= onset_s <= last_s + part.score_test.step_s
        spans.append(last_s - first_s)
    assert spans[1] < HOUR / 6 < spans[0]
