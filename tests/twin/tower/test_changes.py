"""Undeclared changes by auxiliary residuals, and the discrepancy's features."""

from __future__ import annotations

import numpy as np
import pytest

from tests.twin.tower.made_cell import made_cell
from tests.twin.tower.test_calibration import M_W0 as WATER
from tests.twin.tower.test_calibration import SITE, clean, minutes
from twin.tower.air import Array
from twin.tower.calibration import fit_cell
from twin.tower.cell import Inputs
from twin.tower.cell_observations.evidence import Label
from twin.tower.change_detection.changes import undeclared_changes
from twin.tower.clean_cell.commissioning import fit_clean_cell
from twin.tower.clean_cell.discrepancy import AMPLITUDE_K, prior_sd
from twin.tower.estimates import DAY_S, Opening, Priors, time_grid
from twin.tower.model import CALM, NAMES, CellModel, Operation
from twin.tower.twin_file import BOUNDS


@pytest.fixture(scope="module")
def model() -> CellModel:
    return CellModel(fit_clean_cell(clean(), WATER).design, SITE)


def changes_of(model: CellModel, step: tuple[float, float] | None, known: float | None) -> tuple[float, list[Opening]]:
    """Return the record's begin and the changes that are found in 10 days; `known`: day of a declared jump."""
    made = made_cell(10, seed=9, step=step, fill=(0.9, 0.895))
    begin = float(made.time_s[0])
    label = [Label(made.time_s[1440], 1, "bias", 0.3, 0.3, 0.05)]
    at = [Opening(begin + known * DAY_S, begin + known * DAY_S, "bias")] if known is not None else []
    edges = time_grid(begin, float(made.time_s[-1]))
    fitted = fit_cell(model, minutes(made), Priors(BOUNDS), label, at, edges)
    found = undeclared_changes(model, fitted.blocks, Priors(BOUNDS), label, at, fitted.posterior)
    return begin, list(found)


def test_a_step_that_nobody_announced_is_opened_as_a_bias_on_its_day(model: CellModel) -> None:
    begin, found = changes_of(model, (6.0, 0.45), None)
    assert [one.parameter for one in found] == ["bias"]
    assert (found[0].start_s - begin) / DAY_S == pytest.approx(6.0, abs=0.6)


@pytest.mark.parametrize(("step", "known"), [(None, None), ((6.0, 0.45), 6.0)])
def test_nothing_is_opened_without_a_change_or_where_it_is_declared(
    model: CellModel, step: tuple[float, float] | None, known: float | None
) -> None:
    assert changes_of(model, step, known)[1] == []


def operation(wet: Array, flow: Array) -> Operation:
    one = np.ones(len(wet))
    u = Inputs(SITE.inlet * one, WATER * flow, one, wet + 5.0, wet, 99.0 * one)
    return Operation(u, 0.0 * one, CALM * one, 0.0 * one, one)


def test_the_discrepancy_vanishes_at_design_and_has_its_amplitude_far_from_it(model: CellModel) -> None:
    inner = model.features(operation(np.array([SITE.wet]), np.ones(1)))
    assert np.abs(inner).max() < 1e-12
    far = model.features(operation(np.linspace(-25.0, 0.0, 40), np.linspace(0.3, 0.7, 40)))
    spread = prior_sd() * np.sqrt((far**2).sum(axis=1))
    assert np.median(spread) == pytest.approx(AMPLITUDE_K, rel=0.35)


def test_an_outlet_without_weights_is_that_of_the_global_quantities(model: CellModel) -> None:
    o = operation(np.array([10.0, 20.0]), np.array([0.8, 1.0]))
    means, _ = Priors(BOUNDS).constant()
    slow = np.zeros((2, 5))
    assert np.allclose(model.outlet(o, slow, means), model.outlet(o, slow, means[: len(NAMES)]))
    means[len(NAMES) :] = 0.05
    assert np.abs(model.outlet(o, slow, means) - model.outlet(o, slow, means[: len(NAMES)])).max() > 1e-3
