"""Evaporation from the makeup: it narrows a bias that no second thermometer shows, and refuses what does not close."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.tower.made_cell import (
    M_A0,
    M_W0,
    PRESSURE,
    Array,
    Made,
    enthalpy,
    made_cell,
    ratio,
    saturated,
    vapour_of,
)
from tests.twin.tower.test_calibration import SITE, clean, minutes
from twin.tower.calibration import Fitted, fit_cell
from twin.tower.cell import Inputs, solve_cell
from twin.tower.clean_cell.commissioning import fit_clean_cell
from twin.tower.estimates import Priors
from twin.tower.model import CellModel
from twin.tower.shared_observations.evaporation import Balance, with_evaporation
from twin.tower.twin_file import BOUNDS

VOLUME_M3, BLOWN_KG_S = 120.0, 0.8


def evaporated(t_in: Array, t_out: Array, m_w: Array, m_a: Array, dry: Array, wet: Array) -> Array:
    """What evaporates, kg/s, if the air leaves saturated with the heat of the water."""
    w_in = ratio(vapour_of(dry, wet))
    h_out = enthalpy(dry, w_in) + m_w * 4186.0 * (t_in - t_out) / m_a
    low, high = np.full(len(dry), -5.0), np.full(len(dry), 70.0)
    for _ in range(40):
        mid = 0.5 * (low + high)
        warm = enthalpy(mid, ratio(saturated(mid))) > h_out
        low, high = np.where(warm, low, mid), np.where(warm, mid, high)
    return m_a * (ratio(saturated(low)) - w_in)


def of_made(made: Made) -> Array:
    c = made.columns
    rho = PRESSURE / (0.287 * (c["dry_C"] + 273.15)) / 1.13
    m_a = M_A0 * c["fan_speed_pct"] / 100.0 * rho * made.truth["air"]
    return evaporated(c["t_in_C"], made.truth["t_out"], c["m_w_kg_s"], m_a, c["dry_C"], c["wet_rh_C"])


def balance(made: Made, lost: Array, level: bool = True, gain: float = 1.0) -> Balance:
    """A basin that fills between two levels, while some water is blown down."""
    now, filling = 0.6, False
    makeup, levels = np.zeros(len(lost)), np.zeros(len(lost))
    for i, gone in enumerate(lost):
        filling = now < 0.55 or (filling and now < 0.65)
        makeup[i] = 12.0 if filling else 0.0
        now += 60.0 * (makeup[i] - BLOWN_KG_S - gone) / (VOLUME_M3 * 1000.0)
        levels[i] = now
    noisy = levels + np.random.default_rng(0).normal(0, 0.001, len(lost))
    shown = noisy if level else np.full(len(lost), np.nan)
    return Balance(made.time_s, gain * makeup, np.full(len(lost), BLOWN_KG_S), shown, VOLUME_M3)


@pytest.fixture(scope="module")
def model() -> CellModel:
    """The clean cell, its evaporation commissioned at one point of full flow and air."""
    design = fit_clean_cell(clean(), M_W0).design
    u = Inputs(*(np.array([v]) for v in (34.0, M_W0, 1.0, 29.0, 24.0, PRESSURE)))
    own = solve_cell(u, design)
    rho = PRESSURE / (0.287 * (29.0 + 273.15)) / 1.13
    true = evaporated(u.t_in, own.t_out, u.m_w, np.array([M_A0 * rho]), u.dry, u.wet)
    return CellModel(replace(design, evaporation=float((true / own.evaporation)[0])), SITE)


@pytest.fixture(scope="module")
def made() -> Made:
    return made_cell(8, seed=3)


@pytest.fixture(scope="module")
def fitted(model: CellModel, made: Made) -> Fitted:
    return fit_cell(model, minutes(made), Priors(BOUNDS), (), ())


def bias_of(fitted: Fitted, made: Made, water: Balance) -> tuple[float, float, str]:
    """Mean error and standard deviation of the bias at the end, K, and the reason."""
    never = np.zeros(len(made.time_s), dtype=bool)
    (posterior,), reason = with_evaporation([fitted], [never], water)
    return float(np.abs(posterior.slow[:, 3] - 0.3).mean()), float(posterior.sd()[-1, 3]), reason


@pytest.mark.parametrize(("level", "share"), [(True, 0.8), (False, 0.9)])
def test_makeup_narrows_the_bias_towards_its_truth(fitted: Fitted, made: Made, level: bool, share: float) -> None:
    before, sd = float(np.abs(fitted.posterior.slow[:, 3] - 0.3).mean()), float(fitted.posterior.sd()[-1, 3])
    after, narrow, reason = bias_of(fitted, made, balance(made, of_made(made), level))
    assert reason == "" and narrow < share * sd
    assert after < 2.0 * narrow and (after < before or before < sd)


def test_the_gain_of_the_meters_bounds_what_is_learned_however_long_the_record(fitted: Fitted, made: Made) -> None:
    lost = of_made(made)
    plain, narrow, _ = bias_of(fitted, made, balance(made, lost))
    shifted, _, reason = bias_of(fitted, made, balance(made, lost, gain=1.03))
    assert reason == "" and abs(shifted - plain) < 2.0 * narrow and narrow > 0.08


@pytest.mark.parametrize("gain", [0.0, 2.0])
def test_a_makeup_that_contradicts_the_cells_is_left_out(fitted: Fitted, made: Made, gain: float) -> None:
    never = np.zeros(len(made.time_s), dtype=bool)
    water = balance(made, of_made(made), gain=gain)
    (posterior,), reason = with_evaporation([fitted], [never], water)
    assert reason == "NOT_CLOSED" and posterior is fitted.posterior


def test_an_overflow_of_a_night_does_not_reach_the_bias(fitted: Fitted, made: Made) -> None:
    water = balance(made, of_made(made))
    plain, _, _ = bias_of(fitted, made, water)
    spilled = water.makeup.copy()
    spilled[3000:3400] += 15.0
    after, _, reason = bias_of(fitted, made, replace(water, makeup=spilled))
    assert reason == "" and after == pytest.approx(plain, abs=0.05)


def test_unknown_flows_leave_no_whole_sum(fitted: Fitted, made: Made) -> None:
    water = balance(made, of_made(made))
    gaps = water.makeup.copy()
    gaps[np.arange(len(gaps)) % 60 < 10] = np.nan
    assert bias_of(fitted, made, replace(water, makeup=gaps))[2] == "NO_WHOLE_SUM"


def test_a_cell_that_stands_evaporates_nothing(model: CellModel, made: Made, fitted: Fitted) -> None:
    idle = {**made.columns, "m_w_kg_s": np.zeros(len(made.time_s))}
    still = replace(fitted, minutes=minutes(replace(made, columns=idle)))
    lost = of_made(made)
    alone = with_evaporation([fitted], [np.zeros(len(lost), dtype=bool)], balance(made, lost))[0][0]
    both, reason = with_evaporation(
        [fitted, replace(still, blocks=replace(still.blocks, time_s=still.blocks.time_s - 1e9))],
        [np.zeros(len(lost), dtype=bool), np.ones(len(lost), dtype=bool)],
        balance(made, lost),
    )
    assert reason == "" and both[0].slow == pytest.approx(alone.slow, abs=1e-9)
    assert both[1].slow == pytest.approx(fitted.posterior.slow, abs=1e-12)
