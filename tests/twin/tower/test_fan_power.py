"""Fan power as evidence of the air: errors of its law are marginalised, and the fit ends at a mode."""

from __future__ import annotations

import numpy as np
import pytest

from tests.twin.tower.made_cell import Made, made_cell
from tests.twin.tower.test_calibration import M_W0 as WATER
from tests.twin.tower.test_calibration import SITE, clean, minutes
from twin.tower.calibration import fit_cell
from twin.tower.cell_observations.evidence import Label
from twin.tower.cell_observations.fan_power import PowerErrors, PowerRows
from twin.tower.change_detection.changes import undeclared_changes
from twin.tower.clean_cell.commissioning import fit_clean_cell
from twin.tower.estimates import DAY_S, Estimate, Priors, time_grid
from twin.tower.model import NAMES, CellModel
from twin.tower.smoother import estimate
from twin.tower.twin_file import BOUNDS

AIR = 0.89
DAYS = 12


@pytest.fixture(scope="module")
def model() -> CellModel:
    return CellModel(fit_clean_cell(clean(), WATER).design, SITE)


def with_power(change: float, slip_day: float | None = None) -> Made:
    """Return a made cell whose power changes from day to day by errors that the air has not, with this deviation."""
    made = made_cell(DAYS, seed=4, air=AIR, fill=(0.9, 0.895))
    rng = np.random.default_rng(11)
    day = np.arange(len(made.time_s)) / 1440.0
    drift = np.interp(day, np.arange(DAYS + 1), rng.normal(0.0, change, DAYS + 1))
    made.columns["fan_power_kW"] *= np.exp(drift)
    if slip_day is not None:
        made.columns["fan_power_kW"][day >= slip_day] *= 0.95
    return made


def labels_of(made: Made) -> list[Label]:
    """Return two correct traverses, a certificate and a count of nozzles."""
    t = made.time_s
    return [
        Label(t[3 * 1440], 1, "air", AIR - 1.0, AIR - 1.0, 0.02),
        Label(t[9 * 1440], 1, "air", AIR - 1.0, AIR - 1.0, 0.02),
        Label(t[2000], 1, "bias", 0.3, 0.3, 0.05),
        Label(t[7 * 1440], 1, "uniformity", -0.02, 0.02),
    ]


def fitted(model: CellModel, made: Made) -> Estimate:
    edges = time_grid(float(made.time_s[0]), float(made.time_s[-1]))
    return fit_cell(model, minutes(made), Priors(BOUNDS), labels_of(made), (), edges).posterior


@pytest.mark.parametrize("change", [0.0, 0.03])
def test_air_follows_its_traverses_however_the_fan_power_wanders(model: CellModel, change: float) -> None:
    found = fitted(model, with_power(change))
    error = found.slow[:, 1] - (AIR - 1.0)
    assert np.abs(error).mean() < 0.015
    assert (np.abs(error) < 1.645 * found.sd()[:, 1]).mean() > 0.8
    assert found.constant[NAMES.index("kappa")] == pytest.approx(Priors(BOUNDS).constant()[0][NAMES.index("kappa")])


def test_a_step_of_the_fan_power_opens_a_change_of_the_air_on_its_day(model: CellModel) -> None:
    made = with_power(0.0, slip_day=6.0)
    start = fitted(model, made)
    blocks = fit_cell(model, minutes(made), Priors(BOUNDS), labels_of(made), (), start.edges_s).blocks
    found = undeclared_changes(model, blocks, Priors(BOUNDS), labels_of(made), (), start)
    assert [one.parameter for one in found] == ["air"]
    assert (found[0].start_s - made.time_s[0]) / DAY_S == pytest.approx(6.0, abs=0.6)


def test_an_estimate_that_begins_at_another_stays_there(model: CellModel) -> None:
    made = with_power(0.03)
    edges = time_grid(float(made.time_s[0]), float(made.time_s[-1]))
    first = fit_cell(model, minutes(made), Priors(BOUNDS), labels_of(made), (), edges)
    again = estimate(
        model,
        first.blocks,
        Priors(BOUNDS),
        labels_of(made),
        (),
        edges,
        start=first.posterior,
    )
    moved = np.abs(again.slow - first.posterior.slow) / first.posterior.sd()
    assert moved.max() < 0.1
    spread = np.sqrt(np.diag(first.posterior.covariance)[first.posterior.slow.size :])
    assert (np.abs(again.constant - first.posterior.constant) / spread).max() < 0.1


def test_marginal_equations_are_those_of_generalised_least_squares() -> None:
    rng = np.random.default_rng(2)
    n, k = 40, 4
    cell = np.sort(rng.integers(0, k, n))
    features, variance = rng.normal(size=(n, 6)), np.array([1e-4, 4e-4, 1e-4])
    errors = PowerErrors(features, cell, variance)
    rows = PowerRows(rng.normal(size=n), rng.uniform(0.8, 1.0, n), rng.uniform(500.0, 5e3, n))
    target = rng.normal(0.0, 0.1, n)
    hidden = np.concatenate([features, np.eye(k)[cell]], axis=1) * rows.shaft[:, None]
    precision = np.linalg.inv(np.diag(1.0 / rows.weights) + hidden @ np.linalg.inv(errors.precision) @ hidden.T)
    seen = np.column_stack([np.eye(k)[cell] * rows.air[:, None], rows.shaft])
    matrix, right = errors.normal(rows, target)
    np.testing.assert_allclose(matrix, seen.T @ precision @ seen, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(right, seen.T @ precision @ target, rtol=1e-6, atol=1e-4)
    left, squares = errors.remaining(rows, target)
    assert squares == pytest.approx(target @ precision @ target, rel=1e-6)
    np.testing.assert_allclose(rows.weights * left, precision @ target, rtol=1e-6, atol=1e-4)
