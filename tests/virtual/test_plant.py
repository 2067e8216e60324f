"""The plant conserves energy, behaves like a coolant loop, and is the same every time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.virtual.plant.effects import PlantEffect
from drivers.virtual.plant.plant import Plant
from drivers.virtual.plant.water import density_of, enthalpy_of, temperature_of, viscosity_of

HEATER, PM1, PM6, RADIATOR, TANK = 0, 1, 6, 7, 8

EFFECTS = (
    PlantEffect("heat_source", "modules", "constant", "power_W", 180.0, onset_s=20.0),
    PlantEffect("heat_source", "tank", "pump_speed", "power_W", 70.0, shape={"exponent": 3.0}),
    PlantEffect("heat_loss", "tank", "temperature_difference", "conductance_W_per_K", 6.0, shape={"exponent": 1.25}),
    PlantEffect(
        "heat_loss", "pipe_to_radiator", "temperature_difference", "conductance_W_per_K", 2.0, shape={"exponent": 1}
    ),
    PlantEffect("heat_rejection", "radiator", "rejected_heat", "recirculated_fraction", 0.3, onset_s=10.0),
    PlantEffect("heat_rejection", "radiator", "elapsed_time", "lost_fraction", 0.4, ramp_s=60.0),
    PlantEffect("flow", "radiator", "constant", "bypass_fraction", 0.4, onset_s=5.0),
    PlantEffect(
        "thermal_mass", "tank", "history", "capacity_J_per_K", 3e4, 15.0, 0.0, 80.0, {"conductance_W_per_K": 40.0}
    ),
    PlantEffect("actuator", "heater_power", "constant", "gain", 0.9),
)

SETTINGS = st.tuples(st.floats(0, 1000), st.floats(0, 1), st.floats(0, 1), st.integers(1, 60))


def settled(heater_W: float, pump: float, fan: float, hours: float = 3.0, **options: object) -> Plant:
    plant = Plant(**{"seed": 3, "start_C": 33.0, **options})
    for _ in range(int(hours * 3600 / plant.period_s)):
        plant.step(heater_W, pump, fan)
    return plant


@settings(max_examples=60, deadline=None)
@given(st.lists(SETTINGS, min_size=1, max_size=4), st.sets(st.sampled_from(range(len(EFFECTS)))), st.floats(5, 70))
def test_heat_in_minus_heat_out_is_stored(
    schedule: list[tuple[float, float, float, int]], chosen: set[int], start_C: float
) -> None:
    plant = Plant(seed=1, start_C=start_C, effects=tuple(EFFECTS[i] for i in sorted(chosen)))
    before = plant.stored_J()
    for heater_W, pump, fan, steps in schedule:
        for _ in range(steps):
            plant.step(heater_W, pump, fan)
    change = plant.stored_J() - before
    assert change == pytest.approx(plant.heat_in_J() - plant.heat_out_J(), abs=0.01 + 1e-9 * plant.stored_J())
    assert np.isfinite(plant.enthalpy).all()


@settings(max_examples=25, deadline=None)
@given(st.floats(200, 900), st.floats(0.6, 1.0), st.floats(0.4, 0.9))
def test_more_power_is_hotter_and_more_fan_is_cooler(heater_W: float, pump: float, fan: float) -> None:
    base = settled(heater_W, pump, fan, 0.5)
    assert (settled(heater_W + 50.0, pump, fan, 0.5).junction > base.junction).all()
    assert (settled(heater_W, pump, fan + 0.1, 0.5).junction < base.junction).all()


def test_operating_range_is_that_of_the_rig() -> None:
    cool, hot = settled(600.0, 1.0, 1.0, 6.0), settled(900.0, 1.0, 0.4, 6.0)
    assert 28.0 < cool.junction[TANK] < 33.0
    assert 41.0 < hot.junction[TANK] < 46.0
    middle = settled(750.0, 1.0, 0.7, 6.0).junction
    assert middle[HEATER] > middle[PM1] > middle[PM6] > middle[RADIATOR] > middle[TANK] > 30.0


def test_less_flow_takes_more_temperature_rise_over_the_heater() -> None:
    full, low = settled(750.0, 1.0, 0.7), settled(750.0, 0.6, 0.7)
    assert low.flow_L_per_min == pytest.approx(0.6 * full.flow_L_per_min, rel=0.02)
    rise = [plant.junction[HEATER] - plant.junction[TANK] for plant in (full, low)]
    assert rise[1] == pytest.approx(rise[0] / 0.6, rel=0.1)


def test_rejected_heat_equals_heater_power_in_the_long_run() -> None:
    plant = settled(700.0, 1.0, 0.7, 8.0)
    before = plant.heat_out_J()
    for _ in range(3600):
        plant.step(700.0, 1.0, 0.7)
    assert (plant.heat_out_J() - before) / 3600.0 == pytest.approx(plant.heater_power_W, rel=0.02)


def test_heat_travels_round_the_loop_with_a_delay() -> None:
    plant = settled(0.0, 1.0, 0.4, 2.0, start_C=21.0)
    start = plant.junction.copy()
    arrival: dict[int, int] = {}
    for second in range(1, 300):
        plant.step(900.0, 1.0, 0.4)
        for channel in (HEATER, PM1, PM6, RADIATOR, TANK):
            if channel not in arrival and plant.junction[channel] > start[channel] + 0.3:
                arrival[channel] = second
    order = [arrival[channel] for channel in (HEATER, PM1, PM6, RADIATOR, TANK)]
    assert order == sorted(order)
    assert arrival[PM1] - arrival[HEATER] >= 4
    assert arrival[RADIATOR] - arrival[PM6] >= 5


def test_power_lags_the_command_and_droops_a_little() -> None:
    plant = Plant(seed=0)
    plant.step(900.0, 1.0, 0.5)
    assert 200.0 < plant.heater_power_W < 700.0
    for _ in range(30):
        plant.step(900.0, 1.0, 0.5)
    assert 893.0 < plant.heater_power_W < 899.5


def test_without_flow_the_heater_water_overheats_in_minutes() -> None:
    plant = Plant(seed=0)
    for _ in range(240):
        plant.step(1000.0, 0.0, 1.0)
    assert plant.heater_water_C > 75.0
    assert plant.junction[PM1] < 25.0


def test_same_seed_and_writes_give_the_same_plant() -> None:
    def run(seed: int) -> np.ndarray:
        plant = Plant(seed=seed, effects=EFFECTS)
        for k in range(400):
            plant.step(600.0 + k % 7 * 40.0, 1.0, 0.4 + 0.001 * k)
        return np.concatenate([plant.junction, plant.enthalpy, plant.slow])

    assert np.array_equal(run(5), run(5))
    assert not np.array_equal(run(5), run(6))


def test_ten_hertz_is_the_same_physics() -> None:
    slow, fast = Plant(seed=0, start_C=30.0), Plant(seed=0, period_s=0.1, start_C=30.0)
    for second in range(600):
        heater_W = 900.0 if second < 300 else 300.0
        slow.step(heater_W, 1.0, 0.8)
        for _ in range(10):
            fast.step(heater_W, 1.0, 0.8)
    assert fast.time_s == pytest.approx(slow.time_s)
    # The draughts differ: they are drawn per period.
    assert np.abs(fast.junction - slow.junction).max() < 0.1


def test_room_swings_slowly_around_its_mean() -> None:
    plant = Plant(seed=2)
    room = []
    for _ in range(24 * 3600 // 10):
        plant._room.step(plant.time_s)
        plant.steps += 10
        room.append(plant._room.step(plant.time_s))
    assert 20.0 < np.mean(room) < 22.0
    assert 1.5 < np.ptp(room) < 5.0


@given(st.floats(1.0, 90.0))
def test_water_properties(t: float) -> None:
    assert temperature_of(enthalpy_of(t)) == pytest.approx(t, abs=1e-9)
    heat = enthalpy_of(t + 0.5) - enthalpy_of(t - 0.5)
    assert 4170.0 < heat < 4225.0
    assert density_of(t) == pytest.approx(
        np.interp(t, [0, 20, 40, 60, 90], [999.8, 998.2, 992.2, 983.2, 965.3]), rel=2e-3
    )
    assert viscosity_of(t + 1.0) < viscosity_of(t)


def test_a_rig_that_is_switched_on_later_stands_in_the_same_room():
    early, late = Plant(seed=4), Plant(seed=4, start_s=300.0)
    for _ in range(300):
        early.step(800.0, 1.0, 0.5)
    assert late.time_s == early.time_s
    assert late.ambient_C == early.ambient_C
    assert late.junction == pytest.approx(late.ambient_C)  # and is cold
    assert early.junction[HEATER] > late.junction[HEATER] + 2.0
