"""A delay is never negative: a reading that comes earlier than the twin expects refuses the hypothesis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.discovery.conftest import HOUR, STEP_S, Bench
from twin.discovery.effects.catalogue import catalogue
from twin.discovery.effects.formulas import Formulas
from twin.discovery.effects.phrases import said
from twin.discovery.engine import diagnose
from twin.discovery.healthy.basis import Columns
from twin.elements.candidates import Candidate
from twin.kernel import Kernel
from twin.network import Network
from twin.revisions import with_elements
from twin.twinfile import load

TWINS = Path(__file__).resolve().parents[2] / "profiles" / "twins"
HEATER = {"kind": "actuator", "column": "heater_power_W", "lag_s": {"value": 60.0}}
PIPE = {"kind": "pipe", "to": "tank", "ambient": "T_ambient_C", "volume": {"value": 2.0}}


def delays(network: Network) -> list[Candidate]:
    return [c for c in catalogue(network) if "late" in c.says or "only after" in c.says]


@pytest.mark.parametrize("name", ["loop.toml", "loop_six.toml", "tclab.toml"])
def test_no_delay_of_a_shipped_twin_may_be_negative(name: str) -> None:
    assert all(c.lower == 0.0 < c.upper for c in delays(load(TWINS / name)))


def test_delay_that_a_twin_already_has_may_only_grow(bench: Bench) -> None:
    lagging = with_elements(bench.with_values(T_radiator_C__lag_s=20.0), {"relay": HEATER, "hose": PIPE})
    found = {(c.kind, c.where) for c in delays(lagging)}
    assert {("sensor", "T_radiator_C"), ("actuator", "heater_power"), ("delay", "tank")} <= found
    assert all(c.lower == 0.0 for c in delays(lagging))


def test_thermometer_that_is_earlier_than_its_twin_is_not_called_late(brisk: Bench) -> None:
    twin = brisk.of(brisk.with_values(T_radiator_C__lag_s=60.0))
    earlier = brisk.with_values(T_radiator_C__lag_s=20.0)
    found = diagnose(twin.network, twin.record(16.0, seed=3, changed=earlier, onset_h=6.0), twin.record(10.0, seed=7))
    assert "by -" not in found.summary
    late = [e for e in found.effects if "late" in e.says]
    assert all(e.value > 0.0 for e in late)
    assert not [e for e in late if e.where == "T_radiator_C"]


def test_thermometer_that_is_later_than_its_twin_still_is(pair: Bench) -> None:
    twin = pair.of(pair.with_values(T_tank_C__lag_s=20.0))
    later = pair.with_values(T_tank_C__lag_s=80.0)
    found = diagnose(twin.network, twin.record(16.0, seed=3, changed=later, onset_h=6.0), twin.record(10.0, seed=7))
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("sensor", "T_tank_C", "rate_of_change")
    assert effect.value == pytest.approx(60.0, rel=0.2)


def test_interval_of_a_delay_ends_at_zero(bench: Bench) -> None:
    late = next(c for c in delays(bench.network) if c.kind == "sensor")
    assert said(late, 5.0, 12.0).endswith("late by 5 s (0 to 17)")
    both_ways = replace(late, lower=-100.0)
    assert said(both_ways, 5.0, 12.0).endswith("late by 5 s (-7 to 17)")


@pytest.mark.parametrize(("parameter", "seconds"), [("lag_s", 900.0), ("dead_time_s", 240.0)])
def test_heater_that_answers_late_is_told_with_its_form(
    pair: Bench, pair_healthy: Columns, parameter: str, seconds: float
) -> None:
    late = pair.with_element("relay", {"kind": "actuator", "column": "heater_power_W", parameter: seconds})
    found = diagnose(pair.network, pair.record(24.0, seed=3, changed=late, onset_h=8.0), pair_healthy)
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("actuator", "heater_power", "history")
    assert ("only after" in effect.says) == (parameter == "dead_time_s")
    assert effect.value == pytest.approx(seconds, rel=0.1)


def test_a_dead_time_of_more_than_a_load_step_is_told(brisk: Bench, brisk_healthy: Columns) -> None:
    """A delay by two steps of the load resembles neither one by a single step nor one by four."""
    time, inputs = brisk.inputs(24.0, 3)
    given, dead_s, onset_s = inputs.copy(), 700.0, 7.0 * HOUR
    later = time >= onset_s
    given[later, 0] = np.roll(inputs[:, 0], round(dead_s / STEP_S))[later]
    start = np.array(brisk.start_C)
    read, _ = Kernel(brisk.network, ()).trace(brisk.network.values, start, time, given)
    noise = brisk.network.sigma * np.random.default_rng(5).normal(0.0, 1.0, read[0].shape)
    found = diagnose(brisk.network, Columns(time, inputs, read[0] + noise), brisk_healthy)
    (effect,) = found.effects
    assert (effect.kind, effect.where, effect.driver) == ("actuator", "heater_power", "history")
    assert "only after" in effect.says and effect.value == pytest.approx(dead_s, abs=5.0)
    assert effect.onset_s == pytest.approx(onset_s, abs=60.0)


def test_dead_time_longer_than_the_record_leaves_what_was_there_at_first(bench: Bench) -> None:
    late = bench.with_element("relay", {"kind": "actuator", "column": "heater_power_W", "dead_time_s": 3600.0})
    record = bench.record(0.5)
    known = np.tile([37.0, 36.8, 34.5, 34.0], (len(record.time_s), 1))
    first = np.tile(record.inputs[:1, :1], (len(record.time_s), 1))
    waiting = Formulas(late).heats(known, record.inputs, late.values, STEP_S)
    still = Formulas(bench.network).heats(known, np.hstack([first, record.inputs[:, 1:]]), bench.network.values, STEP_S)
    assert waiting == pytest.approx(still)
