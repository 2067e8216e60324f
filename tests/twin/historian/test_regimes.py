"""Regimes of a cell, influence of events, and redundancy checks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin.historian.checks import ABOVE_INLET, BELOW_WET_BULB, FAN_LAW, PUMP_WORK, check_flags
from twin.historian.events import Event, disturbed, influence_of, naming
from twin.historian.regimes import START_UP_MIN, Regime, regimes, start_ups
from twin.historian.tags import Array

N = 300


def _regimes(**changes: Any) -> list[Regime]:
    columns: dict[str, Any] = {
        "flow": np.full(N, 200.0),
        "in_service": np.ones(N),
        "command": np.full(N, 80.0),
        "speed": np.full(N, 80.0),
        "bypass": np.zeros(N),
        "fault": np.zeros(N),
        "disturbed": np.zeros(N, dtype=bool),
    }
    return [Regime(int(code)) for code in regimes(**(columns | changes))]


def _from(minute: int, before: float, after: float) -> Array:
    return np.where(np.arange(N) < minute, before, after)


def test_a_settled_cell_has_the_regime_of_its_fan() -> None:
    for speed, regime in ((0.0, Regime.FREE_CONVECTION), (40.0, Regime.LOW_FAN), (90.0, Regime.HIGH_FAN)):
        assert set(_regimes(command=np.full(N, speed), speed=np.full(N, speed))) == {regime}


def test_water_that_begins_to_flow_is_a_start_up_for_twenty_minutes() -> None:
    found = _regimes(flow=_from(100, 0.0, 200.0))
    assert set(found[:100]) == {Regime.OFF}
    assert set(found[100:120]) == {Regime.START_UP}
    assert set(found[120:]) == {Regime.HIGH_FAN}


def test_a_step_of_the_fan_is_a_transition_of_ten_minutes() -> None:
    found = _regimes(command=_from(100, 80.0, 50.0), speed=_from(102, 80.0, 50.0))
    assert set(found[100:112]) == {Regime.FAN_TRANSITION}
    assert set(found[112:]) == {Regime.LOW_FAN}


def test_a_fan_that_does_not_follow_or_is_faulted_is_an_upset() -> None:
    assert set(_regimes(speed=np.zeros(N))) == {Regime.UPSET}
    assert set(_regimes(fault=np.ones(N))) == {Regime.UPSET}
    assert set(_regimes(disturbed=np.ones(N, dtype=bool))) == {Regime.UPSET}


def test_an_open_bypass_is_a_regime_of_its_own() -> None:
    assert set(_regimes(bypass=np.full(N, 40.0))) == {Regime.BYPASS}


def test_unknown_flow_is_taken_from_the_service_state_and_unknown_both_is_an_upset() -> None:
    unknown = np.full(N, np.nan)
    assert set(_regimes(flow=unknown, in_service=np.zeros(N))) == {Regime.OFF}
    assert set(_regimes(flow=unknown, in_service=unknown)) == {Regime.UPSET}


def test_a_regime_does_not_depend_on_later_minutes() -> None:
    whole = _regimes(command=_from(200, 80.0, 20.0), speed=_from(200, 80.0, 20.0), flow=_from(50, 0.0, 200.0))
    rows = {
        name: values[:200]
        for name, values in {
            "flow": _from(50, 0.0, 200.0),
            "in_service": np.ones(N),
            "command": np.full(N, 80.0),
            "speed": np.full(N, 80.0),
            "bypass": np.zeros(N),
            "fault": np.zeros(N),
        }.items()
    }
    part = regimes(**rows, disturbed=np.zeros(200, dtype=bool))
    assert [Regime(int(code)) for code in part] == whole[:200]


def test_an_event_of_a_minute_disturbs_its_cell_for_its_hours() -> None:
    minute_s = 60.0 * np.arange(600)
    trip = Event(6000.0, False, 1, "fan_trip", "DCS")
    rows = disturbed((trip,), 1, minute_s)
    assert np.flatnonzero(rows)[[0, -1]].tolist() == [100, 100 + 240 - 1]
    assert not disturbed((trip,), 2, minute_s).any()
    assert disturbed((Event(6000.0, False, 0, "fan_trip", "DCS"),), 2, minute_s).any()


def test_an_entry_of_a_day_disturbs_no_minute_and_may_be_days_off() -> None:
    entry = Event(86400.0 * 10, True, 1, "nozzle_cleaning", "CMMS", "nozzles of T1OUT and T2OUT")
    assert not disturbed((entry,), 1, 60.0 * np.arange(20000)).any()
    assert naming((entry,), ("T1OUT", "T2OUT"), 86400.0 * 13.5)
    assert not naming((entry,), ("T1OUT", "T2OUT"), 86400.0 * 20)
    assert not naming((entry,), ("T1OUT", "T3OUT"), 86400.0 * 10)


@pytest.mark.parametrize(
    ("kind", "text", "moved"),
    [
        ("nozzle_cleaning", "", ("uniformity",)),
        ("inspection", "scale seen", ()),
        ("wartung", "fan blades adjusted", ("air",)),
        ("note", "outlet thermometer replaced", ("bias",)),
        ("note", "fill looked at", ()),
    ],
)
def test_only_documented_maintenance_moves_a_parameter(kind: str, text: str, moved: tuple[str, ...]) -> None:
    found = influence_of(kind, text).parameters
    assert set(moved) <= set(found) and bool(found) == bool(moved)


def _columns(**changes: Array) -> dict[str, Any]:
    speed = np.linspace(40.0, 100.0, N)
    columns = {
        "fan_speed_pct": speed,
        "fan_power_kW": 40.0 * (speed / 100.0) ** 3,
        "pump_kW": np.full(N, 100.0),
        "m_w_kg_s": np.full(N, 200.0),
        "header_kPa": np.full(N, 150.0),
        "t_in_C": np.full(N, 30.0),
        "t_out_C": np.full(N, 24.0),
        "wet_C": np.full(N, 20.0),
        "wet_rh_C": np.full(N, 20.0),
    }
    return columns | changes


def test_a_cell_in_order_fails_no_check() -> None:
    flags, remarks = check_flags(_columns())
    assert not flags.any() and remarks == []


@pytest.mark.parametrize(
    ("name", "value", "bit"),
    [
        ("fan_power_kW", 2.0, FAN_LAW),
        ("pump_kW", 0.0, PUMP_WORK),
        ("t_out_C", 18.0, BELOW_WET_BULB),
        ("t_out_C", 32.0, ABOVE_INLET),
    ],
)
def test_a_quantity_that_contradicts_another_is_marked(name: str, value: float, bit: int) -> None:
    columns = _columns()
    columns[name] = np.where(np.arange(N) >= 200, value, columns[name])
    flags, remarks = check_flags(columns)
    assert (flags[230:] & bit).all() and not (flags[:200] & bit).any()
    assert remarks


def test_a_header_without_pressure_is_no_error() -> None:
    flags, _ = check_flags(_columns(header_kPa=np.zeros(N), m_w_kg_s=np.where(np.arange(N) < 9, 0.0, 200.0)))
    assert not (flags & PUMP_WORK).any()


def test_unknown_quantities_fail_no_check() -> None:
    columns = {name: np.full(N, np.nan) for name in _columns()}
    flags, _ = check_flags(columns)
    assert not flags.any()


def test_a_start_up_is_where_water_flows_after_it_was_known_to_rest() -> None:
    codes = np.full(200, Regime.HIGH_FAN, dtype=np.uint8)
    codes[:50] = codes[100:110] = codes[115:118] = codes[150:160] = Regime.OFF
    known = np.ones(200, dtype=bool)
    known[155:165] = False  # it rested before the gap, and flows after it
    assert START_UP_MIN > 8  # two starts at 110 and 118 are one
    assert start_ups(codes, known).tolist() == [50, 110, 165]
    assert start_ups(codes[:50], known[:50]).tolist() == []
