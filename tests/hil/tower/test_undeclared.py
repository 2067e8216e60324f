"""Undeclared changes of a cell: found in the hours in which its fan turns, and with the time that is known of them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.tower.calibration import station_fit
from hil.tower.calibration.remarks import step_sentence
from hil.tower.calibration.station_fit import DRIVEN, fit_with_steps, undeclared_jumps
from tests.twin.tower.made_cell import made_cell
from tests.twin.tower.test_calibration import M_W0 as WATER
from tests.twin.tower.test_calibration import SITE, clean, minutes
from twin.tower.calibration import fit_cell
from twin.tower.cell_observations.evidence import Label
from twin.tower.change_detection.steps import Step
from twin.tower.clean_cell.commissioning import fit_clean_cell
from twin.tower.estimates import DAY_S, Priors, time_grid
from twin.tower.model import CellModel
from twin.tower.twin_file import BOUNDS


def test_hours_of_free_convection_are_no_change_of_the_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    model = CellModel(fit_clean_cell(clean(), WATER).design, SITE)
    made = made_cell(6, seed=4, fill=(0.9, 0.895))
    begin, read = float(made.time_s[0]), minutes(made)
    calm = made.time_s > begin + 4.0 * DAY_S
    u = read.operation.inputs
    operation = replace(read.operation, inputs=replace(u, speed=np.where(calm, 0.5 * DRIVEN, u.speed)))
    read = replace(read, operation=operation, power=np.where(calm, np.nan, read.power))
    labels = [Label(begin + DAY_S, 1, "bias", 0.3, 0.3, 0.05)]
    fitted = fit_cell(model, read, Priors(BOUNDS), labels, (), time_grid(begin, float(made.time_s[-1])))
    asked: list[Any] = []
    monkeypatch.setattr(station_fit, "undeclared_changes", lambda _, blocks, *__: asked.append(blocks) or ())
    undeclared_jumps(fitted, SimpleNamespace(time_s=made.time_s, columns={}), Priors(BOUNDS), labels, ())
    (blocks,) = asked
    late = blocks.time_s > begin + 4.1 * DAY_S
    assert np.isfinite(fitted.blocks.outlet[late]).any()
    assert not np.isfinite(blocks.outlet[late]).any() and np.isfinite(blocks.outlet[~late]).mean() > 0.9


def test_a_step_within_a_stop_has_the_ends_of_the_stop_and_no_minute() -> None:
    at = 1.66e9 // 86400 * 86400
    seen = Step(at, at + 300.0, 0.45, True)
    assert step_sentence(seen) == "the outlet thermometer or the water stepped by +0.45 K at 2022-08-08T00:00:00Z"
    within = step_sentence(replace(seen, stop_s=1.5 * DAY_S))
    assert "between 2022-08-06T12:00:00Z and 2022-08-08T00:00:00Z, without a steady reading in between" in within


def test_a_cell_whose_rate_of_loss_changes_is_fitted_again_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    model = CellModel(fit_clean_cell(clean(), WATER).design, SITE)
    read = minutes(made_cell(4, seed=4))
    record: Any = SimpleNamespace()
    monkeypatch.setattr(station_fit, "undeclared_jumps", lambda *_: ((), ()))
    sds = []
    for rates in ({}, {"fill": 0.008}):
        monkeypatch.setattr(station_fit, "changing_rate", lambda *_, found=rates: found)
        fitted, _, _ = fit_with_steps(model, read, record, Priors(BOUNDS), (), ())
        sds.append(fitted.posterior.sd()[:, 0])
    assert (sds[1] > sds[0]).all()
