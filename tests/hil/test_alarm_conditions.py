"""Conditions of alarms on blocks of ticks: the same as those of the interlocks, however a run is cut into blocks."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.rig_file import HeaterPowerSpec, LimitSpec, NoFlowSpec, Point, RateOfRiseSpec
from drivers.signals import Quality, Signal
from hil.alarms.definitions import AlarmDefinition
from hil.alarms.detection import Delay, Ticks, detector_of
from hil.run.interlocks.conditions import (
    ActuatorDisagreement,
    FrozenCounter,
    LimitViolation,
    NoFlow,
    NoGoodValue,
    RateOfRise,
    RigTrip,
    TickValues,
)
from hil.run.interlocks.interlocks import Interlock

SIGNALS = (
    Signal("power_set", "W", "setpoint", bus="plc"),
    Signal("power", "W", bus="plc"),
    Signal("T", "degC", bus="plc"),
    Signal("flow", "L/min", bus="plc"),
    Signal("status", "1", "status", bus="plc"),
    Signal("other", "degC", bus="plc"),
)
T = Point(name="T", bus="plc", unit="degC", table="input", address=0)
POWER_SET = Point(
    name="power_set", bus="plc", unit="W", access="rw", table="holding", address=1, limits=(0, 100), safe_value=0,
    readback="power",
)  # fmt: skip
LIMIT = LimitSpec(kind="limit", level="warning", point="T", high=5.0, deadband=2.0)
RATE = RateOfRiseSpec(kind="rate_of_rise", level="warning", point="T", high=0.9, window_s=4.0, deadband=0.5)
FLOW = NoFlowSpec(kind="no_flow", level="warning", heater="power", above=2.0, flow="flow", low=4.0, deadband=1.0)
HEATER = HeaterPowerSpec(kind="heater_power", level="warning", setpoint="power_set", tolerance=3.0, deadband=1.0)


def item(kind: str, points: tuple[str, ...], limit: float | None = None, **rest: object) -> AlarmDefinition:
    return AlarmDefinition(id="x", kind=kind, priority="low", points=points, limit=limit, bus="plc", **rest)  # type: ignore[arg-type]


PAIRS = {
    "high": (item("high", ("T",), 5.0, deadband=2.0), LimitViolation(T, -np.inf, 5.0, 2.0)),
    "low": (item("low", ("T",), 4.0, deadband=1.0), LimitViolation(T, 4.0, np.inf, 1.0)),
    "rate_of_rise": (item("rate_of_rise", ("T",), 0.9, window_s=4.0, deadband=0.5), lambda: RateOfRise(RATE, "degC")),
    "no_flow": (
        item("no_flow", ("flow", "power", "power_set"), 4.0, above=2.0, deadband=1.0),
        NoFlow(FLOW, "power_set"),
    ),
    "disagreement": (
        item("disagreement", ("power_set", "power"), 3.0, deadband=1.0),
        ActuatorDisagreement(POWER_SET, "power", 3.0, 1.0),
    ),
    "sensor": (item("sensor", ("T",), drains=True), NoGoodValue(T, 5.0, True)),
    "rig_trip": (item("rig_trip", ("status",), mask=6), RigTrip("status", 6)),
    "rig_counter": (item("rig_counter", ("status",), window_s=2.0), lambda: FrozenCounter("status", 2.0)),
}
VALUES = st.lists(st.integers(0, 8), min_size=5, max_size=5)
QUALITY = st.sampled_from([0, 0, 0, 0, 1, 2, 3, 4])
ROWS = st.lists(st.tuples(VALUES, st.lists(QUALITY, min_size=4, max_size=4)), min_size=1, max_size=40)


def ticks_of(rows: list[tuple[list[int], list[int]]]) -> Ticks:
    """Return rows as a block; `other` is always good, so that the link never counts as lost."""
    values = np.array([[*row, 20.0] for row, _ in rows], dtype=float)
    quality = np.array([[0, *marks, 0] for _, marks in rows], dtype=np.uint8)
    return Ticks(np.arange(len(rows), dtype=float), values, quality)


def cut(ticks: Ticks, sizes: list[int]) -> list[Ticks]:
    bounds = [*itertools.accumulate([0, *sizes]), len(ticks.time_s)]
    spans = [slice(a, b) for a, b in itertools.pairwise(min(b, len(ticks.time_s)) for b in bounds)]
    return [Ticks(ticks.time_s[s], ticks.values[s], ticks.quality[s]) for s in spans]


def edges(definition: AlarmDefinition, blocks: list[Ticks]) -> list[tuple[float, bool]]:
    detector, delay = detector_of(definition, SIGNALS, 1.0), Delay(definition)
    assert detector is not None
    return [
        (float(block.time_s[k]), active)
        for block in blocks
        for k, active in delay.block(block.time_s, detector.block(block))
    ]


@pytest.mark.parametrize("kind", PAIRS)
@settings(max_examples=60)
@given(ROWS, st.sampled_from([0.0, 1.0, 3.0]), st.sampled_from([0.0, 2.0]))
def test_an_alarm_comes_and_goes_with_the_interlock_of_its_kind(kind, rows, on_delay_s, off_delay_s):
    definition, made = PAIRS[kind]
    definition = definition.model_copy(update={"on_delay_s": on_delay_s, "off_delay_s": off_delay_s})
    interlock = Interlock("warning", made() if callable(made) else made, on_delay_s, off_delay_s)
    ticks, expected, asked = ticks_of(rows), [], 0.0
    names = [signal.name for signal in SIGNALS]
    for k, now_s in enumerate(ticks.time_s):
        values = dict(zip(names, ticks.values[k], strict=True))
        quality = dict(zip(names, ticks.quality[k].tolist(), strict=True))
        was = interlock.active
        interlock.update(TickValues(float(now_s), values, quality, {"power_set": asked}))
        asked = values["power_set"]
        if interlock.active is not was:
            expected.append((float(now_s), interlock.active))
    assert edges(definition, [ticks]) == expected


@pytest.mark.parametrize("kind", [*PAIRS, "deviation", "link"])
@settings(max_examples=30)
@given(ROWS, st.lists(st.integers(0, 9), max_size=8))
def test_the_cut_of_a_run_into_blocks_changes_nothing(kind, rows, sizes):
    definition = (
        PAIRS[kind][0]
        if kind in PAIRS
        else item("link", (), on_delay_s=1.0)
        if kind == "link"
        else item("deviation", ("power_set", "power"), 2.0, window_s=3.0, on_delay_s=1.0)
    )
    ticks = ticks_of(rows)
    assert edges(definition, cut(ticks, sizes)) == edges(definition, [ticks])


def course(power_set: list[float], power: list[float]) -> Ticks:
    values = np.zeros((len(power), len(SIGNALS)))
    values[:, 0], values[:, 1] = power_set, power
    return Ticks(np.arange(len(power), dtype=float), values, np.zeros(values.shape, dtype=np.uint8))


def test_a_meter_that_follows_a_ramp_with_its_lag_deviates_never_and_one_that_stands_does():
    asked = np.clip(np.arange(200.0) - 20.0, 0.0, 100.0)
    lagged = np.concatenate([np.zeros(8), asked[:-8]])
    definition = item("deviation", ("power_set", "power"), 1.0, window_s=10.0, on_delay_s=10.0)
    assert edges(definition, [course(asked.tolist(), lagged.tolist())]) == []
    stuck = np.where(np.arange(200) < 60, lagged, lagged[60])
    found = edges(definition, [course(asked.tolist(), stuck.tolist())])
    assert [active for _, active in found] == [True] and 60.0 < found[0][0] < 90.0


def test_a_lost_bus_is_one_alarm_and_not_one_of_each_sensor():
    ticks = course([0.0] * 20, [0.0] * 20)
    ticks.quality[5:15, 1:] = Quality.LINK_FAULT
    link = item("link", (), on_delay_s=3.0, off_delay_s=2.0, drains=True)
    assert edges(link, [ticks]) == [(8.0, True), (17.0, False)]
    assert edges(item("sensor", ("T",), on_delay_s=3.0, drains=True), [ticks]) == []
    ticks.quality[2:, 2] = Quality.SENSOR_FAULT
    assert edges(item("sensor", ("T",), on_delay_s=1.0, drains=True), [ticks])[0] == (3.0, True)


def test_an_alarm_on_a_signal_that_the_run_does_not_record_is_left_out():
    assert detector_of(item("high", ("gone",), 1.0), SIGNALS, 1.0) is None
