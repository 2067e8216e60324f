"""Undeclared changes by auxiliary residuals, and the discrepancy's features."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.twin.tower.made_cell import made_cell
from tests.twin.tower.test_calibration import M_W0 as WATER
from tests.twin.tower.test_calibration import SITE, clean, minutes
from twin.tower.air import Array
from twin.tower.calibration import fit_cell
from twin.tower.cell import Inputs
from twin.tower.cell_observations.evidence import Label
from twin.tower.change_detection import changes
from twin.tower.change_detection.changes import _window, undeclared_changes
from twin.tower.clean_cell.commissioning import fit_clean_cell
from twin.tower.clean_cell.discrepancy import AMPLITUDE_K, prior_sd
from twin.tower.estimates import (
    DAY_S,
    JUMP,
    RATE_D,
    RATE_SD,
    WALK,
    Opening,
    Priors,
    moved_grid,
    time_grid,
    unread_days,
    walk_precision,
    walk_variance,
)
from twin.tower.model import CALM, NAMES, CellModel, Operation
from twin.tower.twin_file import BOUNDS


def test_an_unknown_rate_adds_a_variance_that_is_common_to_all_increments() -> None:
    edges = time_grid(0.0, 20 * DAY_S)
    days = np.diff(0.5 * (edges[:-1] + edges[1:])) / DAY_S
    precision, mean = walk_precision(edges, "fill", ())
    variance, drift = walk_variance(edges, "fill", ())
    expected = np.diag(variance) + RATE_SD["fill"] ** 2 * np.outer(days, days)
    assert np.allclose(np.linalg.inv(precision), expected, rtol=1e-6, atol=0.0) and np.allclose(mean, drift)
    assert np.count_nonzero(
        walk_precision(edges, "bias", ())[0] - np.diag(1.0 / walk_variance(edges, "bias", ())[0])
    ) <= len(days)


def test_days_without_a_reading_have_the_variance_of_jumps_that_nobody_sees() -> None:
    edges = time_grid(0.0, 60 * DAY_S)
    read = np.ones(120, dtype=bool)
    read[20:80] = False  # 30 days
    read[100:104] = False  # two days: a jump in them is told by the levels about them
    days = unread_days(edges, read)
    assert days.sum() == pytest.approx(30.0) and (days[:19] == 0.0).all() and (days[80:] == 0.0).all()
    variance, _ = walk_variance(edges, "bias", (), days)
    walked, _ = walk_variance(edges, "bias", ())
    assert (variance - walked).sum() == pytest.approx(RATE_D["bias"] * 30.0 * JUMP["bias"] ** 2)
    assert np.sqrt(variance[19:80].sum()) > 3.0 * WALK["bias"] * np.sqrt(30.0)


def test_a_thermometer_that_was_exchanged_while_nothing_was_read_is_within_its_interval(model: CellModel) -> None:
    made = made_cell(24, seed=9, step=(12.0, 0.45), fill=(0.9, 0.89))
    begin, read = float(made.time_s[0]), minutes(made)
    day = (made.time_s - begin) / DAY_S
    outage = replace(read, outlet=np.where((day > 8.0) & (day < 18.0), np.nan, read.outlet))
    labels = [Label(begin + DAY_S, 1, "bias", 0.3, 0.3, 0.05)]
    edges = time_grid(begin, float(made.time_s[-1]))
    p = fit_cell(model, outage, Priors(BOUNDS), labels, [], edges).posterior
    # The jump is not opened, and still the 95 % interval after the outage holds the new bias.
    assert abs(p.slow[-1, 3] - 0.75) < 1.96 * p.sd()[-1, 3] < 0.2


def test_a_fill_that_scales_fast_is_followed_within_its_interval(model: CellModel) -> None:
    made = made_cell(16, seed=5, fill=(1.0, 0.90), test_days=(2, 7, 12))
    begin = float(made.time_s[0])
    labels = [Label(begin + DAY_S, 1, "bias", 0.3, 0.3, 0.05), Label(begin + DAY_S, 1, "air", -0.07, -0.07, 0.015)]
    edges = time_grid(begin, float(made.time_s[-1]))
    p = fit_cell(model, minutes(made), Priors(BOUNDS), labels, [], edges).posterior
    truth = np.interp(0.5 * (edges[:-1] + edges[1:]), made.time_s, made.truth["fill"])
    found, sd = 1.0 + p.slow[:, 0], p.sd()[:, 0]
    assert (np.abs(found - truth) <= 1.645 * sd).mean() > 0.9


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


@pytest.mark.parametrize(
    ("fill_score", "stop_h", "first"), [(10.5, 0.0, "bias"), (11.9, 0.0, "bias"), (11.9, 9.0, "fill")]
)
def test_a_jump_is_of_the_deviation_that_fits_best_and_of_a_fill_if_somebody_could_work_on_it(
    monkeypatch: pytest.MonkeyPatch, fill_score: float, stop_h: float, first: str
) -> None:
    """The bias has large scores everywhere, since a thermometer also drifts: that tells whether it jumped, and not that
    something else has."""
    edges = np.arange(41) * DAY_S / 2
    usual = {"fill": 0.9, "uniformity": 0.8, "bias": 1.3, "air": 1.0}
    top = {"fill": fill_score, "uniformity": 8.0, "bias": 11.5, "air": 1.0}
    rng, scores = np.random.default_rng(3), {}
    for name in RATE_D:
        own = usual[name] * rng.choice([-1.0, 1.0], 39)
        own[20] = top[name]
        information = np.full(39, 1000.0 / JUMP[name] ** 2)
        scores[name] = own * np.sqrt(information), information
    monkeypatch.setattr(changes, "_scores", lambda _, __, name: scores[name])
    time_s = np.arange(0.0, edges[-1], 1800.0)
    at = edges[21]
    time_s = time_s[(time_s <= at) | (time_s > at + stop_h * 3600.0)]
    estimate = SimpleNamespace(edges_s=edges, residual=np.zeros(len(time_s)))
    (event,) = changes._likely(estimate, (), time_s)
    assert event[0].parameter == first and event[0].start_s == at


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


def test_a_jump_in_days_without_readings_is_opened_anywhere_in_them() -> None:
    edges = np.arange(21) * DAY_S
    odds = np.full(19, -3.0)
    odds[8:12] = 4.0  # edges 9 to 12 lie in an outage: their odds are those of its ends
    assert _window(odds, edges, 9) == (9 * DAY_S, 12 * DAY_S)
    odds[9] = 12.0
    assert _window(odds, edges, 9) == (10 * DAY_S, 10 * DAY_S)


def test_the_grid_has_an_edge_at_a_jump_of_known_time_and_the_jump_lies_there_alone() -> None:
    edges = time_grid(0.0, 500.0 * DAY_S)  # cells of more than a day
    at = 100.4 * DAY_S
    moved = moved_grid(edges, [at, at + 60.0])  # the second is nearest to the same edge
    assert at in moved and (np.diff(moved) > 0.0).all() and (moved != edges).sum() == 1
    variance, _ = walk_variance(moved, "bias", [Opening(at, at + 600.0, "bias")])
    k = int(variance.argmax())
    assert moved[k + 1] == at
    assert variance[k] - np.median(variance) == pytest.approx(JUMP["bias"] ** 2, rel=0.01)


def test_a_constant_that_multiplies_a_walk_is_considered_and_not_estimated(model: CellModel) -> None:
    made = made_cell(8, seed=4)
    counted = Label(made.time_s[2000], 1, "uniformity", -0.11, -0.09, source="nozzles counted")
    p = fit_cell(model, minutes(made), Priors(BOUNDS), [counted], ()).posterior
    wetting = NAMES.index("wetting")
    assert p.constant[wetting] == pytest.approx(1.0, abs=1e-3)
    assert p.constant_covariance()[wetting, wetting] == pytest.approx(0.25**2, rel=1e-3)
    alone = np.sqrt(np.diag(p.covariance)[: p.slow.size]).reshape(p.slow.shape)
    assert (p.sd() >= alone).all()
    assert (p.sd()[:, 3] > 1.01 * alone[:, 3]).all()  # the uniformity itself is counted


def test_a_jump_of_the_bias_is_located_between_the_readings_of_its_cell(model: CellModel) -> None:
    begin, (found,) = changes_of(model, (6.2, 0.45), None)
    assert (found.parameter, found.start_s) == ("bias", found.end_s)
    assert (found.start_s - begin) / DAY_S == pytest.approx(6.2, abs=0.03)  # cells have half a day
