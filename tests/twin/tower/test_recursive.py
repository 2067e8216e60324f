"""Recursive Gauss-Newton: beliefs from earlier readings alone, and what moves them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.tower.made_cell import M_W0, Made, made_cell
from tests.twin.tower.test_calibration import SITE, clean, minutes
from twin.tower.calibration import fit_cell
from twin.tower.cell_observations.evidence import Label
from twin.tower.clean_cell.commissioning import fit_clean_cell
from twin.tower.estimates import DAY_S, Estimate, Opening, Priors
from twin.tower.minutes import blocks_of
from twin.tower.model import CellModel
from twin.tower.recursive import Recursion, filter_cell
from twin.tower.twin_file import BOUNDS

DAYS, HEALTHY = 9.0, 3.0


@pytest.fixture(scope="module")
def model() -> CellModel:
    return CellModel(fit_clean_cell(clean(), M_W0).design, SITE)


@pytest.fixture(scope="module")
def made() -> Made:
    return made_cell(DAYS, seed=2, fill=(0.9, 0.9), air=0.97, bias=0.2, step=(6.0, 0.6))


@pytest.fixture(scope="module")
def healthy(model: CellModel, made: Made) -> Estimate:
    whole = minutes(made)
    rows = slice(0, int(HEALTHY * 1440))
    first = replace(
        whole,
        time_s=whole.time_s[rows],
        operation=whole.operation.take(rows),
        outlet=whole.outlet[rows],
        power=whole.power[rows],
        known=whole.known[rows],
        steady=whole.steady[rows],
        regime=whole.regime[rows],
    )
    return fit_cell(model, first, Priors(BOUNDS), (), ()).posterior


def beliefs(
    model: CellModel, made: Made, healthy: Estimate, labels: tuple[Label, ...] = (), openings: tuple[Opening, ...] = ()
) -> Recursion:
    m = minutes(made)
    end = float(m.time_s[0]) + HEALTHY * DAY_S
    return filter_cell(model, m, blocks_of(m)[0], Priors(BOUNDS), healthy, end, labels, openings)


def test_a_belief_knows_no_reading_of_its_own_target_or_later(model: CellModel, made: Made, healthy: Estimate) -> None:
    plain = beliefs(model, made, healthy)
    at = len(plain.start_s) // 2
    later = made.time_s >= plain.start_s[at]
    columns = {**made.columns, "t_out_C": made.columns["t_out_C"] + 2.0 * later}
    other = beliefs(model, replace(made, columns=columns), healthy)
    np.testing.assert_array_equal(plain.mean[: at + 1], other.mean[: at + 1])
    np.testing.assert_array_equal(plain.fit[: at + 1], other.fit[: at + 1])
    assert np.abs(plain.mean[at + 3] - other.mean[at + 3]).max() > 0.05


def test_a_step_of_the_thermometer_becomes_bias_sooner_where_an_entry_opens_it(
    model: CellModel, made: Made, healthy: Estimate
) -> None:
    step = float(made.time_s[0]) + 6.0 * DAY_S
    plain = beliefs(model, made, healthy)
    opened = beliefs(model, made, healthy, openings=(Opening(step - 3600.0, step + 3600.0, "bias"),))
    day_after = int(np.searchsorted(plain.start_s, step + DAY_S))
    before = int(np.searchsorted(plain.start_s, step)) - 1
    rise = [one.mean[day_after, 3] - one.mean[before, 3] for one in (plain, opened)]
    assert rise[1] > rise[0] > 0.1
    assert rise[1] == pytest.approx(0.6, abs=0.15)


def test_a_certificate_narrows_the_bias_from_its_own_time_on(model: CellModel, made: Made, healthy: Estimate) -> None:
    at = float(made.time_s[0]) + 4.0 * DAY_S
    plain = beliefs(model, made, healthy)
    told = beliefs(model, made, healthy, labels=(Label(at, 1, "bias", 0.2, 0.2, 0.02),))
    before = plain.start_s <= at
    np.testing.assert_array_equal(plain.sd[before], told.sd[before])
    after = int(np.searchsorted(plain.start_s, at + 4.0 * 3600.0))
    assert told.sd[after, 3] < 0.8 * plain.sd[after, 3]


def test_the_linearised_twin_is_the_twin_at_the_belief(model: CellModel, made: Made, healthy: Estimate) -> None:
    found = beliefs(model, made, healthy)
    m = minutes(made)
    last = np.flatnonzero(m.known & m.steady)[-200:]
    slow = np.zeros((len(last), 5))
    slow[:, :3] = found.reference[found.chunk[last]]
    moved = slow.copy()
    moved[:, 0] -= 0.05
    o = m.operation.take(last)
    constants = healthy.constant
    change = model.outlet(o, moved, constants) - model.outlet(o, slow, constants)
    assert np.isfinite(found.water[last]).all()
    assert np.abs(-0.05 * found.slopes[last, 0] - change).mean() < 0.15 * np.abs(change).mean()
