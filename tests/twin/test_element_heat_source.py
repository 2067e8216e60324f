"""Heat sources: each law against its formula, and what makes no sense."""

from collections.abc import Mapping

import numpy as np
import pytest

from tests.twin.two_nodes import U, heat, network, worst_error
from twin.discovery.effects.catalogue import catalogue
from twin.elements.candidates import Candidate
from twin.elements.heat_source import daylight_parameters
from twin.network import TwinFileError

HOURS = U.size - 4


def source(driver: str, law: str, values: str) -> str:
    return f'[elements.x]\nkind = "heat_source"\nnode = "b"\ndriver = "{driver}"\nlaw = "{law}"\n{values}\n'


def at_hour(hour: float) -> np.ndarray:
    u = U.copy()
    u[HOURS] = hour
    return u


def form(weights: Mapping[str, float]) -> np.ndarray:
    """Heat of a source by daylight over one day before it is cut off at nothing, every six minutes."""
    turn = np.linspace(0.0, 2.0 * np.pi, 240, endpoint=False)
    return weights["cosine"] * np.cos(turn) + weights["sine"] * np.sin(turn) - weights["night"]


def test_constant_and_measured_power() -> None:
    assert heat('[elements.x]\nkind = "heat_source"\nnode = "b"\npower = 25.0\n') == pytest.approx([0.0, 25.0])
    assert heat(source("heater_power_W", "proportional", "factor = 0.9")) == pytest.approx([0.0, 450.0])


def test_any_measured_column() -> None:
    text = source("fan_speed_pct", "linear", 'gain = { value = 0.4, unit = "W/%" }\nreference = 10.0')
    assert heat(text) == pytest.approx([0.0, 0.4 * 40.0])
    text = source(
        "T_supply_C", "linear", 'gain = { value = 3.0, unit = "W/K" }\nreference = { value = 30.0, unit = "K" }'
    )
    assert heat(text) == pytest.approx([0.0, 15.0])


def test_pump_heat_follows_the_cube_of_the_speed() -> None:
    assert heat(source("pump_speed_pct", "cubed", "power_100 = 50.0")) == pytest.approx([0.0, 50.0 * 0.8**3])


@pytest.mark.parametrize("hour", [0.0, 3.3, 6.0, 11.9, 12.0, 17.5, 24.0, 30.5, -2.0])
def test_time_of_day(hour: float) -> None:
    angle = 2.0 * np.pi * hour / 24.0
    expected = -20.0 * np.cos(angle) + 7.0 * np.sin(angle)
    values = "cosine = -20.0\nsine = 7.0"
    assert heat(source("time_of_day_h", "daily", values), inputs=at_hour(hour)) == pytest.approx(
        [0.0, expected], abs=1e-6
    )
    light = heat(source("time_of_day_h", "daylight", values), inputs=at_hour(hour))
    assert light == pytest.approx([0.0, max(expected, 0.0)], abs=1e-6)


@pytest.mark.parametrize(("peak_h", "hours"), [(12.0, 12.0), (11.7, 8.5), (23.0, 14.0)])
def test_a_day_is_as_long_and_as_warm_as_it_is_said_to_be(peak_h: float, hours: float) -> None:
    values = "\n".join(f"{name} = {60.0 * value}" for name, value in daylight_parameters(peak_h, hours).items())

    def at(hour: float) -> float:
        return float(heat(source("time_of_day_h", "daylight", values), inputs=at_hour(hour))[1])

    assert at(peak_h) == pytest.approx(60.0, abs=1e-5)
    for side in (-0.5, 0.5):
        assert at(peak_h + side * (hours - 0.2)) > 0.0
        assert at(peak_h + side * (hours + 0.2)) == 0.0


@pytest.mark.parametrize(("peak_h", "hours"), [(10.3, 3.4), (15.0, 18.5), (0.4, 9.0)])
def test_any_day_can_be_come_near_to_from_those_that_are_tried_first(peak_h: float, hours: float) -> None:
    wanted = np.maximum(form(daylight_parameters(peak_h, hours)), 0.0)

    def off(candidate: Candidate) -> float:
        seen = np.maximum(form({name.rsplit(".", 1)[1]: value for name, value in candidate.changes.items()}), 0.0)
        return float(((wanted - seen * (wanted @ seen) / (seen @ seen)) ** 2).sum())

    tried = [c for c in catalogue(network("")) if c.driver == "time_of_day" and c.where == "b"]
    assert len(tried) == 12
    best = min(tried, key=off)
    while best.near is not None:
        best = min(best.near(), key=off)
    assert off(best) < 0.01 * float((wanted**2).sum())


@pytest.mark.parametrize(
    "text",
    [
        source("pump_speed_pct", "cubed", "power_100 = 300.0"),
        source("time_of_day_h", "daily", "cosine = 200.0\nsine = -100.0"),
        source("time_of_day_h", "daylight", "cosine = 200.0\nsine = -100.0"),
        source("T_supply_C", "linear", "gain = 5.0\nreference = 20.0"),
    ],
)
def test_kernel_agrees_with_solve_ivp(text: str) -> None:
    assert worst_error(text) < 1e-6


@pytest.mark.parametrize(
    ("driver", "law"),
    [
        ("pump_speed_pct", "cubed"),
        ("time_of_day_h", "daily"),
        ("time_of_day_h", "daylight"),
        ("q_m3_h", "linear"),
    ],
)
def test_without_values_a_driven_source_is_none(driver: str, law: str) -> None:
    assert heat(source(driver, law, "")) == pytest.approx([0.0, 0.0])


def test_drivers_that_make_no_sense() -> None:
    with pytest.raises(TwinFileError, match="not a power"):
        network(source("T_supply_C", "proportional", ""))
    with pytest.raises(TwinFileError, match="not a speed"):
        network(source("T_supply_C", "cubed", ""))
    with pytest.raises(TwinFileError, match="not a time of day"):
        network(source("pump_speed_pct", "daily", ""))
    with pytest.raises(TwinFileError, match="needs a driver"):
        network('[elements.x]\nkind = "heat_source"\nnode = "b"\nlaw = "cubed"\n')
