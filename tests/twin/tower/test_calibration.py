"""Calibration of a made cell: deviations, intervals, the outlet with its window hidden, and evidence beside the
record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.tower.made_cell import EXPONENT, M_A0, M_W0, ME0, Made, made_cell, made_points
from twin.tower.calibration import CalibrationError, fit_cell, predict_cell
from twin.tower.cell import Inputs
from twin.tower.cell_observations.evidence import Label, interval_as_gaussian
from twin.tower.clean_cell.commissioning import CommissioningError, TestPoints, fit_clean_cell
from twin.tower.estimates import Opening, Priors
from twin.tower.minutes import Minutes, blocks_of, first_order_lag, minutes_of
from twin.tower.model import CellModel, DesignPoint
from twin.tower.smoother import estimate
from twin.tower.twin_file import BOUNDS

SITE = DesignPoint(34.0, 24.0, 6.0)


def clean(**changes: float) -> TestPoints:
    v = made_points()
    u = Inputs(
        v["water_inlet_C"],
        v["water_flow_kg_s"] * changes.get("flow", 1.0),
        v["fan_speed_pct"] / 100,
        v["dry_bulb_C"],
        v["entering_wet_bulb_C"],
        v["pressure_kPa"],
    )
    air = v["air_flow_kg_s"] * changes.get("air", 1.0)
    return TestPoints(u, v["water_outlet_C"] + changes.get("out", 0.0), v["fan_power_kW"], air, np.full(14, np.nan))


@pytest.fixture(scope="module")
def model() -> CellModel:
    return CellModel(fit_clean_cell(clean(), M_W0).design, SITE)


def minutes(made: Made) -> Minutes:
    return minutes_of(made.time_s, made.columns, made.origin, M_W0, 0.0)


def test_commissioning_finds_the_clean_cell_of_another_solver() -> None:
    found = fit_clean_cell(clean(), M_W0)
    assert found.design.merkel == pytest.approx(ME0, rel=0.03)
    assert found.design.exponent == pytest.approx(
        EXPONENT, abs=0.15
    )  # the made cell wets all of its plan at every flow
    assert found.design.m_a0 == pytest.approx(M_A0, rel=0.02)
    assert found.rmse < 0.08
    assert any("evaporation" in remark for remark in found.remarks)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"air": 8.0}, "water over air"),
        ({"out": -4.0}, "Merkel number|RMSE"),
        ({"flow": 2.2}, "Merkel number|RMSE|exponent"),
    ],
)
def test_commissioning_refuses_points_that_make_no_cooling_tower(changes: dict[str, float], says: str) -> None:
    with pytest.raises(CommissioningError, match=says):
        fit_clean_cell(clean(**changes), M_W0)


def test_points_that_were_entered_again_are_no_further_points() -> None:
    points = clean()
    rows = np.zeros(12, dtype=int)
    again = TestPoints(
        points.inputs.take(rows), *(getattr(points, n)[rows] for n in ("t_out", "power", "m_a", "evaporation"))
    )
    with pytest.raises(CommissioningError, match=r"has 12 test points, of which 1 differ; at least 4 different"):
        fit_clean_cell(again, M_W0)


def test_outlets_of_a_day_that_mostly_contradicts_the_wet_bulb_are_not_used() -> None:
    made = made_cell(4)
    check = np.zeros(len(made.time_s))
    check[2880:4320] = 4.0
    check[2880:4320:7] = 0.0  # readings of the fault that happen to be possible
    check[100] = 4.0  # and a single bad one in a day of good ones
    made.columns["check"] = check
    found = np.isfinite(minutes(made).outlet)
    made.columns["check"] = np.zeros(len(check))
    before = np.isfinite(minutes(made).outlet)
    assert before[3000:4200].any() and not found[3000:4200].any()
    assert (found == before)[:2000][np.arange(2000) != 100].all()


def test_deviations_are_found_with_intervals_and_the_outlet_gets_better(model: CellModel) -> None:
    made = made_cell(10, seed=3)
    labels = [
        Label(made.time_s[7 * 1440], 1, "bias", 0.3, 0.3, 0.05),
        Label(made.time_s[4 * 1440], 1, "air", -0.07, -0.07, 0.02),
        Label(made.time_s[5 * 1440], 1, "uniformity", -0.03, 0.03),
    ]
    got = predict_cell(fit_cell(model, minutes(made), Priors(BOUNDS), labels, ()))
    there = np.isfinite(got.t_out)
    truth = made.truth["t_out"]
    before = np.abs(got.commissioned - truth)[there].mean()
    after = np.abs(got.t_out - truth)[there].mean()
    assert there.mean() > 0.95 and before > 0.3 and after < 0.4 * before
    assert np.abs(got.deviations[:, 0] + 1 - made.truth["fill"]).mean() < 0.05
    assert np.abs(got.deviations[:, 3] - 0.3).mean() < 0.12
    half = 1.645 * got.sd[:, 0]
    assert (np.abs(got.deviations[:, 0] + 1 - made.truth["fill"]) < half).mean() > 0.8
    covered = (np.abs(got.t_out - truth) <= got.high - got.t_out)[there].mean()
    assert covered > 0.8


def test_outlet_of_a_window_does_not_follow_its_own_readings(model: CellModel) -> None:
    made = made_cell(4, seed=5)
    base = predict_cell(fit_cell(model, minutes(made), Priors(BOUNDS), (), ()))
    # The readings of one target interval are off by 1 K: its own prediction must hardly move, towards them least of
    # all.
    rows = slice(2 * 1440 + 600, 2 * 1440 + 720)
    moved = made_cell(4, seed=5)
    moved.columns["t_out_C"][rows] += 1.0
    other = predict_cell(fit_cell(model, minutes(moved), Priors(BOUNDS), (), ()))
    assert np.nanmax(np.abs(other.t_out - base.t_out)[rows]) < 0.08


def test_a_window_that_alone_shows_a_fan_at_rest_is_no_measure_of_its_minutes_with_the_fan(model: CellModel) -> None:
    made = made_cell(6, seed=12)
    minute = np.arange(len(made.time_s))
    rest = (minute >= 4 * 1440 + 720) & (minute < 4 * 1440 + 780)  # the first hour of a window
    still = {"fan_speed_pct": 0.0, "fan_command_pct": 0.0, "fan_power_kW": 0.1}
    columns = made.columns | {name: np.where(rest, v, made.columns[name]) for name, v in still.items()}
    # Wind has stalled the draft: the water hardly cools.
    columns["t_out_C"] = np.where(rest, made.columns["t_in_C"] - 0.1 + made.truth["bias"], made.columns["t_out_C"])
    changed = replace(made, columns=columns)
    found = predict_cell(fit_cell(model, minutes(changed), Priors(BOUNDS), (), ()))
    water = np.where(rest, made.columns["t_in_C"] - 0.1, made.truth["t_out"])
    off = np.abs(found.t_out - water)
    first, last = np.flatnonzero(rest)[[0, -1]]
    assert 0.4 < np.median(off[first + 15 : last]) < 1.5  # nothing else shows it
    assert np.median(off[last + 16 : first + 120]) < 0.3


def test_a_window_without_readings_has_nothing_to_hide(model: CellModel) -> None:
    made = made_cell(6, seed=13)
    minute = np.arange(len(made.time_s))
    silent = (minute >= 3 * 1440) & (minute < 3 * 1440 + 120)
    changed = replace(made, columns=made.columns | {"t_out_C": np.where(silent, np.nan, made.columns["t_out_C"])})
    fitted = fit_cell(model, minutes(changed), Priors(BOUNDS), (), ())
    p = fitted.posterior
    slow = p.slow[p.cells_at(fitted.minutes.time_s)]
    plain = first_order_lag(model.outlet(fitted.minutes.operation, slow, p.constant), fitted.minutes.known)
    assert np.array_equal(predict_cell(fitted).t_out[silent], plain[silent])
    assert not np.array_equal(predict_cell(fitted).t_out[~silent], plain[~silent])


def test_too_short_a_record_is_refused(model: CellModel) -> None:
    with pytest.raises(CalibrationError, match="steady blocks"):
        fit_cell(model, minutes(made_cell(0.2)), Priors(BOUNDS), (), ())


def test_a_documented_exchange_opens_a_jump_of_the_bias_and_nothing_else_does(model: CellModel) -> None:
    made = made_cell(8, seed=7, step=(4.0, 0.6), fill=(0.9, 0.9))
    at = float(made.time_s[4 * 1440])
    label = [Label(made.time_s[1440], 1, "bias", 0.3, 0.3, 0.05)]
    opened = predict_cell(
        fit_cell(model, minutes(made), Priors(BOUNDS), label, [Opening(at - 3600, at + 3600, "bias")])
    )
    closed = predict_cell(fit_cell(model, minutes(made), Priors(BOUNDS), label, ()))
    bias = opened.deviations[:, 3]
    assert bias[6 * 1440] - bias[2 * 1440] == pytest.approx(0.6, abs=0.12)
    assert abs(opened.deviations[6 * 1440, 0] - opened.deviations[2 * 1440, 0]) < 0.02
    slow = closed.deviations[:, 3]
    assert abs(slow[6 * 1440] - slow[2 * 1440]) < 0.3


@pytest.mark.parametrize(("mean", "sd", "moves"), [(0.0, 0.01, False), (0.2, 0.05, True), (-0.3, 0.1, True)])
def test_an_inspection_says_nothing_inside_its_interval_and_pulls_from_outside(
    mean: float, sd: float, moves: bool
) -> None:
    value, spread = interval_as_gaussian(-0.1, 0.1, mean, sd)
    joint = (mean / sd**2 + value / spread**2) / (1 / sd**2 + 1 / spread**2)
    assert (abs(joint - mean) > 0.2 * sd) == moves
    assert abs(joint) <= abs(mean) + 1e-9


def test_a_record_without_a_barometer_has_the_pressure_of_its_site() -> None:
    made = made_cell(0.5)
    columns = {**made.columns, "pressure_kPa": np.full(len(made.time_s), np.nan)}
    minutes = minutes_of(made.time_s, columns, made.origin, M_W0, 0.0, site_kPa=83.4)
    assert (minutes.operation.inputs.pressure == 83.4).all()


def test_the_amplitude_of_the_discrepancy_comes_from_the_record(model: CellModel) -> None:
    blocks, _ = blocks_of(minutes(made_cell(6, seed=1)))
    u = blocks.operation.inputs
    wave = np.sin(u.wet / 2.0) * np.cos(6.0 * u.speed)
    found = [
        estimate(model, replace(blocks, outlet=blocks.outlet + size_K * wave), Priors(BOUNDS), (), ()).amplitude
        for size_K in (0.0, 0.5)
    ]
    assert found[0] < 1.0 < found[1]
