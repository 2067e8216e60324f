"""Identifiability: the order and size of condition numbers by excitation and sensors, refusal, frozen parameter,
plan."""

from __future__ import annotations

import numpy as np
import pytest

from twin.tower.cell import CellDeviations, Design, Inputs, solve_cell
from twin.tower.identifiability.identify import cell_sensitivities, excited, identifiability
from twin.tower.identifiability.planning import plan_tests

CELL = Design(250.0, 205.0, 1.47, 0.6, 45.0, 1.15)
AT = CellDeviations(0.92, 0.95, 0.96, 0.0)
SENSORS = {"T": "outlet", "F": "fan", "E": "evaporation", "B": "basin"}
KAPPA = 0.6


def day(fan: float = 0.0, flow: float = 0.0, load: float = 0.0, seed: int = 0, wet_range: float = 6.0) -> Inputs:
    """A day of a cell about 80 % of fan speed, with square waves of fan and flow and a swing of the load."""
    t = np.arange(0, 1440, 5) / 1440.0
    wet = 17.0 + np.random.default_rng(seed).normal(0, 3) + 0.5 * wet_range * np.sin(2 * np.pi * (t - 0.4))
    dry = wet + 4.0 + 3.0 * np.sin(2 * np.pi * (t - 0.4))
    speed = 0.8 + 0.5 * fan * np.sign(np.sin(6 * np.pi * t + 0.3))
    m_w = 250.0 * (1 + 0.5 * flow * np.sign(np.sin(4 * np.pi * t + 1.1)))
    fall = 7.0 * (1 + 0.5 * load * np.sin(2 * np.pi * t + 0.7))
    t_in = wet + 12.0
    fixed = np.full(len(t), 99.0)
    for _ in range(30):
        t_in = t_in + 1.2 * (fall - (t_in - solve_cell(Inputs(t_in, m_w, speed, dry, wet, fixed), CELL, AT).t_out))
    return Inputs(t_in, m_w, speed, dry, wet, fixed)


def condition(sensors: str, **excitation: float) -> float:
    names = [SENSORS[letter] for letter in sensors]
    found = [
        identifiability(cell_sensitivities(CELL, day(seed=s, **excitation), names, AT, KAPPA), 5.0).condition
        for s in range(4)
    ]
    return float(np.median(found))


TABLE = [
    ("TFEB", {}, 244.0),
    ("TFEB", {"load": 0.3}, 158.0),
    ("TF", {"load": 0.3, "fan": 0.15}, 102.0),
    ("TFEB", {"load": 0.3, "fan": 0.15}, 81.0),
    ("TFE", {"load": 0.3, "fan": 0.15, "flow": 0.12}, 41.0),
    ("T", {"load": 0.3, "fan": 0.4, "flow": 0.3}, 28.0),
    ("TFEB", {"load": 0.3, "fan": 0.4, "flow": 0.3}, 15.0),
    ("TFEB", {"load": 0.8, "fan": 0.4, "flow": 0.5}, 10.0),
]
"""Excitation and sensors with the condition number that 20 days of Chicago weather gave, in falling order."""


@pytest.mark.parametrize(("sensors", "excitation", "published"), TABLE)
def test_condition_numbers_by_excitation_are_those_of_the_study(
    sensors: str, excitation: dict[str, float], published: float
) -> None:
    # Another weather, and the load's shape is not given: within a third.
    assert condition(sensors, **excitation) == pytest.approx(published, rel=0.35)


DEVIATIONS_SD = [
    ("TFEB", {"load": 0.3}, {"fill": 0.51, "uniformity": 0.22, "bias": 0.06}),
    ("TF", {"load": 0.3, "fan": 0.15}, {"fill": 0.38, "uniformity": 0.21, "bias": 0.53}),
    ("TFEB", {"load": 0.3, "fan": 0.15}, {"fill": 0.26, "uniformity": 0.12, "bias": 0.06}),
    ("TFE", {"load": 0.3, "fan": 0.15, "flow": 0.12}, {"fill": 0.15, "uniformity": 0.064, "bias": 0.08}),
    ("T", {"load": 0.3, "fan": 0.4, "flow": 0.3}, {"fill": 0.13, "air": 0.066, "uniformity": 0.028, "bias": 0.29}),
    ("TFEB", {"load": 0.3, "fan": 0.4, "flow": 0.3}, {"fill": 0.049, "uniformity": 0.019, "bias": 0.06}),
    ("TFEB", {"load": 0.8, "fan": 0.4, "flow": 0.5}, {"fill": 0.032, "uniformity": 0.011, "bias": 0.06}),
]
"""Excitation and sensors with the Cramer-Rao standard deviations of the same study."""


@pytest.mark.parametrize(("sensors", "excitation", "published"), DEVIATIONS_SD)
def test_standard_deviations_by_excitation_are_those_of_the_study(
    sensors: str, excitation: dict[str, float], published: dict[str, float]
) -> None:
    names = [SENSORS[letter] for letter in sensors]
    days = [
        identifiability(cell_sensitivities(CELL, day(seed=s, **excitation), names, AT, KAPPA), 5.0) for s in range(4)
    ]
    found = {name: float(np.median([one.sd[name] for one in days])) for name in published}
    assert found == pytest.approx(published, rel=0.4)


def test_a_second_thermometer_or_evaporation_separates_the_bias() -> None:
    def bias(sensors: str) -> float:
        rows = cell_sensitivities(CELL, day(load=0.3, fan=0.15), [SENSORS[s] for s in sensors], AT, KAPPA)
        return identifiability(rows, 5.0).sd["bias"]

    assert bias("TF") > 0.3 > 0.15 > bias("TFE") and bias("TFEB") < bias("TFE")


def test_without_a_change_of_flow_a_lone_thermometer_is_singular() -> None:
    assert condition("T", load=0.3, fan=0.0) > 300.0


def test_a_confounded_window_is_refused_and_names_the_weaker_of_the_pair() -> None:
    rows = cell_sensitivities(CELL, day(load=0.3), ["outlet", "fan", "basin"], AT, KAPPA)
    told = identifiability(rows, 5.0)
    assert told.condition > 80.0 and told.refused == "LOW_SENSITIVITY:fill"
    assert {"fill", "uniformity"} == {n for n, w in told.combined.items() if abs(w) > 0.5}
    assert "fill" in told.says() and told.condition_left <= 80.0


def test_a_window_with_a_quarter_of_its_channels_hidden_is_refused() -> None:
    rows = cell_sensitivities(CELL, day(load=0.8, fan=0.4, flow=0.5), ["outlet", "fan", "basin"], AT, KAPPA)
    assert identifiability(rows, 5.0, hidden=0.2).refused == ""
    assert identifiability(rows, 5.0, hidden=0.3).refused == "MISSING_REQUIRED"


def test_a_wide_wet_bulb_alone_passes_the_threshold_and_is_refused_all_the_same() -> None:
    u = day(wet_range=9.0)
    assert excited(u, CELL)
    assert identifiability(cell_sensitivities(CELL, u, ["outlet", "fan", "basin"], AT, KAPPA), 5.0).refused


def test_the_planned_test_makes_the_day_identifiable_within_the_limit() -> None:
    without, tests = plan_tests(CELL, day(load=0.3), AT, ["outlet", "fan", "basin"], most_warmer=2.0)
    assert without.condition > 80.0
    assert tests[0].told.condition < 40.0 and tests[0].flow > 0.0
    assert all(test.warmer <= 2.0 for test in tests)
    assert tests[0].told.condition == min(test.told.condition for test in tests)
