"""Tags that stand: constant by nature, or stuck while what they measure moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.twin.historian.made_station import START_S, ZONE, archived, clean_store, instruments, scanned
from twin.historian.defects import Repaired, find_and_repair
from twin.historian.defects.stuck import stuck_values
from twin.historian.tags import Array, Series, Tag

DAY_S = 86400.0


def _series(role: str, unit: str, value: Array, cell: int | None = 1) -> Series:
    n = len(value)
    return Series(Tag(role, unit, role, cell, 180.0), START_S + 180.0 * np.arange(n), value, np.full(n, 192, np.int16))


@pytest.fixture
def moving() -> Array:
    return np.asarray(40.0 + 20.0 * np.sin(np.arange(4800) / 150.0))


def _stuck(series: Series, *others: Series) -> list[str]:
    return [defect.says for defect in stuck_values(series, others)]


def test_a_fan_at_full_speed_all_month_is_right(moving: Array) -> None:
    full = _series("fan_speed", "1", np.ones(4800))
    noise = np.random.default_rng(0).standard_normal(4800)
    power, command = (
        _series("fan_power", "kW", 42.0 + 0.5 * noise),
        _series("fan_speed_command", "%", full.value * 100.0),
    )
    assert _stuck(full) == _stuck(full, power) == _stuck(full, power, command) == []


def test_a_fan_that_runs_at_one_speed_or_not_at_all_is_right() -> None:
    on = (np.arange(4800) // 200) % 3 > 0
    speed = _series("fan_speed", "%", 100.0 * on)
    assert _stuck(speed, _series("fan_power", "kW", 42.0 * on)) == []


@pytest.mark.parametrize(("role", "unit"), [("fan_speed_command", "%"), ("fan_power", "kW")])
def test_a_speed_that_stands_while_command_or_power_move_is_stuck(moving: Array, role: str, unit: str) -> None:
    found = _stuck(_series("fan_speed", "%", np.full(4800, 64.0)), _series(role, unit, moving))
    assert len(found) == 1 and role in found[0] and "stood at 64 %" in found[0]


def test_a_constant_flow_is_right_with_a_constant_pump_and_stuck_with_another(moving: Array) -> None:
    flow = _series("water_flow", "gpm", np.full(4800, 2850.0))
    pump = _series("pump_power", "kW", np.full(4800, 90.0), None)
    assert _stuck(flow) == _stuck(flow, pump) == []
    assert len(_stuck(flow, replace(pump, value=2.0 * moving))) == 1


def test_a_thermometer_that_stands_throughout_while_its_water_moves_is_stuck(moving: Array) -> None:
    outlet = _series("water_outlet_temperature", "degF", np.full(4800, 75.0))
    assert len(_stuck(outlet, _series("water_inlet_temperature", "degF", moving))) == 1
    assert (
        _stuck(
            outlet,
            replace(_series("water_inlet_temperature", "degF", moving), tag=Tag("B", "degF", "basin_temperature", 2)),
        )
        == []
    )


def test_days_at_one_commanded_speed_are_no_defect_of_a_fan_that_moves_otherwise() -> None:
    rng = np.random.default_rng(40)
    store = []
    for one in instruments(rng, 20.0):
        time_s, value = scanned(one, rng)
        if one.tag.name in ("SC1", "SI1", "JI1"):
            inside = (time_s > START_S + 6 * DAY_S) & (time_s < START_S + 9 * DAY_S)
            value = np.where(inside & (value > 0.0), {"SC1": 80.0, "SI1": 80.0, "JI1": 20.5}[one.tag.name], value)
        store.append(archived(one, (time_s, value)))
    found = _repaired(store)
    assert [one.says for one in found.defects if one.tags == ("SI1",)] == []


def test_a_constant_tag_of_a_station_stays_and_is_named() -> None:
    store = [
        replace(one, value=np.full(len(one.value), 300.0)) if one.tag.name == "F1" else one
        for one in clean_store(np.random.default_rng(41), 10.0)
        if one.tag.name not in ("JP", "PH")
    ]
    found = _repaired(store)
    assert [one.kind for one in found.defects if "F1" in one.tags] == []
    assert any("F1 stands at 300 m3/h" in text for text in found.remarks)


@pytest.mark.parametrize("name", ["F1", "F2"])
def test_a_flow_at_zero_while_its_cell_works_is_stuck_and_a_cell_at_rest_is_none(name: str) -> None:
    rng = np.random.default_rng(43)
    plant = instruments(rng, 16.0)
    on = next(one.truth for one in plant if one.tag.name == f"ON{name[1]}") > 0.5
    at = float(np.flatnonzero(np.convolve(on, np.ones(601), mode="same") > 600.5)[0] - 200) * 60.0 + START_S
    store = []
    for one in plant:
        time_s, value = scanned(one, rng)
        inside = (time_s > at) & (time_s < at + 6 * 3600.0)
        store.append(archived(one, (time_s, np.where(inside & (one.tag.name == name), 0.0, value))))
    (found,) = _repaired(store).defects
    assert (found.kind, found.tags) == ("stuck", (name,)) and "while its cell's fan turned" in found.says
    assert found.start_s == pytest.approx(at, abs=600.0) and found.end_s == pytest.approx(at + 6 * 3600.0, abs=900.0)


@pytest.mark.parametrize("begins", [True, False])
def test_a_flow_that_sticks_at_zero_from_or_until_a_rest_of_its_cell_is_stuck(moving: Array, begins: bool) -> None:
    n = np.arange(4800)
    rest, late = (n > 2000) & (n < 2300), (n >= 2300) & (n < 2420)
    if not begins:
        late = (n > 1880) & (n <= 2000)
    warm = _series("water_inlet_temperature", "degC", moving)
    cold = replace(warm, value=np.where(rest, moving, moving - 6.0))
    cold = replace(cold, tag=replace(cold.tag, role="water_outlet_temperature"))
    fan = _series("fan_speed", "%", np.where(rest, 0.0, 60.0 + moving))
    flow = _series("water_flow", "m3/h", np.where(rest, 0.0, 300.0 + moving))
    assert _stuck(flow, warm, cold, fan) == []
    stuck = replace(flow, value=np.where(late, 0.0, flow.value))
    (found,) = stuck_values(stuck, (stuck, warm, cold, fan))
    silent = fan.rows(~((n >= 1990) & (n < 2150)))
    still_cold = replace(cold, value=moving - 6.0)
    # The fan turned when its interface fell silent, and stood after it.
    assert _stuck(flow, warm, still_cold, silent) == []
    at = flow.time_s[late]
    assert found.start_s == pytest.approx(at[0], abs=1200.0) and found.end_s == pytest.approx(at[-1], abs=1200.0)


def test_a_fan_that_often_turns_without_a_flow_is_a_habit(moving: Array) -> None:
    """As it dries the cell, or where the meter is in a line of its own."""
    rest = (np.arange(4800) % 1200) > 900
    warm = _series("water_inlet_temperature", "degC", moving)
    cold, fan = replace(warm, value=moving - 6.0), _series("fan_speed", "%", moving)
    cold = replace(cold, tag=replace(cold.tag, role="water_outlet_temperature"))
    flow = _series("water_flow", "m3/h", np.where(rest, 0.0, 300.0 + moving))
    once = replace(flow, value=np.where(rest & (np.arange(4800) > 3600), 0.0, 300.0 + moving))
    assert len(_stuck(once, warm, cold, fan)) == 1
    idle = replace(fan, value=np.where(rest & (np.arange(4800) < 3600), 0.0, moving))
    assert len(_stuck(flow, warm, cold, idle)) == 1
    dried = replace(cold, value=np.where(rest & (np.arange(4800) < 3600), moving, moving - 6.0))
    assert _stuck(flow, warm, dried, fan) == []


def _repaired(store: list[Series]) -> Repaired:
    return find_and_repair(store, timezone=ZONE, pressure_kPa=95.0)


def test_a_value_that_stands_on_both_sides_of_a_gap_stood_in_it(moving: Array) -> None:
    """Else none of its parts is set off from the longest run of a healthy tag."""
    rng = np.random.default_rng(44)
    value = np.round(moving + 0.5 * rng.standard_normal(4800), 1)
    value[1000:1500] = 55.5
    value[3000:3140] = 44.4
    one = _series("water_inlet_temperature", "degC", value)
    time_s = START_S + 180.0 * np.arange(4800)
    holes = np.array([[time_s[1180], time_s[1200]], [time_s[1360], time_s[1380]]])
    rows = ~((time_s > holes[0, 0]) & (time_s < holes[0, 1])) & ~((time_s > holes[1, 0]) & (time_s < holes[1, 1]))
    found = stuck_values(replace(one.rows(rows), holes=holes))
    assert max(defect.end_s - defect.start_s for defect in found) > 24.0 * 3600.0


@pytest.mark.parametrize("moves", [True, False])
def test_a_power_that_stands_for_hours_while_its_fan_moves_is_stuck(moves: bool) -> None:
    """Its habit tells nothing: at one speed it stands as long."""
    rng = np.random.default_rng(45)
    speed = np.full(4800, 45.0) + np.where(np.arange(4800) // 60 % 2 == 0, 10.0, 0.0)
    speed[1000:1060] = 45.0
    if moves:
        speed[1030:1050] = 60.0
    power = np.round(20.0 * (speed / 60.0) ** 3 + 0.3 * rng.standard_normal(4800), 1)
    power[1000:1060] = 8.4
    power[3004:3042] = power[3004]  # at one speed
    fan = [_series("fan_speed", "Hz", speed), _series("fan_speed_command", "Hz", speed)]
    found = _stuck(_series("fan_power", "kW", power), *fan)
    assert [text.split(", ")[1].split()[:2] for text in found] == ([["while", "fan_speed"]] if moves else [])


def test_a_run_that_one_of_many_tags_has_by_chance_is_no_stuck_value() -> None:
    """Where one of fifty hourly samples repeats another, a tag of three hundred has four alike in one of 300 records.

    So has a station of fifty tags in one of six; five alike are rare for it, too.
    """
    value = 24.0 + 0.01 * np.random.default_rng(41).permutation(300)
    value[21:300:50] = value[20:299:50]
    value[101:104] = value[100]
    outlet = replace(_series("water_outlet_temperature", "degC", value), time_s=START_S + 3600.0 * np.arange(300))
    many = [replace(outlet, tag=replace(outlet.tag, name=f"T{k}")) for k in range(50)]
    assert len(_stuck(outlet)) == 1
    assert _stuck(outlet, *many) == []
    value[104] = value[100]
    assert len(_stuck(outlet, *many)) == 1
