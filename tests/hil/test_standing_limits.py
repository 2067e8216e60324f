"""Limits without times while the profile stands: they trip a run that is held, paused or restored."""

from __future__ import annotations

import pytest

from drivers.rig import rig_signals
from hil.run.engine.operator import Verb
from hil.testing import LiveTest, RigSignals, bind, read_plan
from tests.hil.engine_bench import EngineBench, cut_at
from tests.hil.made_plan import plan_text
from tests.hil.simulated_rig import rig_with

WAITS_S = 1000.0
TRIP = "test small: limit L1"


def bench_with(tmp_path, sentence: str, waits_s: float = WAITS_S, **more) -> EngineBench:
    """A bench whose run a failed limit trips."""
    rig, path = rig_with(waits_s), tmp_path / "plan.toml"
    path.write_text(plan_text(sentence, head='trip_on = "major"'), encoding="utf-8")
    plan, signals = read_plan(path), rig_signals(rig)
    limits = bind(plan, RigSignals(signals, {}, (), 600.0, rig.period_s, "rig bench"))
    return EngineBench(rig, watch=LiveTest(plan, limits, signals, rig.period_s, lambda line: None), **more)


def tripped(bench: EngineBench) -> bool:
    return any(reason.startswith(TRIP) for reason in bench.engine.status().trips)


@pytest.mark.parametrize("verb", [Verb.HOLD, Verb.PAUSE])
def test_a_value_beyond_its_limit_trips_a_run_that_stands(tmp_path, verb):
    with bench_with(tmp_path, "T_heater < 60 degC") as bench:
        bench.ticks(30)
        bench.ask(verb)
        bench.ticks(3)
        assert not tripped(bench)
        bench.rig.readings["T_heater"] = 65.0
        bench.ticks(2)
        assert tripped(bench) and bench.state == "paused"
        assert "65 °C while the profile stands" in bench.engine.status().trips[0]
        bench.ticks(5)
        assert bench.rig.heater_W == 0.0
        bench.ask(Verb.ACK)
        bench.ticks(5)
        assert tripped(bench)  # still there
        del bench.rig.readings["T_heater"]
        bench.ticks(2)
        bench.ask(Verb.ACK)
        bench.ticks(2)
        assert not tripped(bench) and not bench.violations


def test_a_value_beyond_its_limit_ends_a_thermal_restore(tmp_path):
    aim = {"T_tank": 60.0}
    with bench_with(tmp_path, "T_heater < 60 degC", resumption=cut_at(50.0, aim)) as bench:
        bench.ticks(3)
        assert bench.state == "restoring"
        bench.rig.readings["T_heater"] = 65.0
        bench.ticks(3)
        assert bench.state == "faulted" and bench.outcome.reason.startswith(TRIP)
        assert bench.rig.heater_W == 0.0


@pytest.mark.parametrize("sentence", ["T_heater < 60 degC before 500 s", "T_heater < 60 degC after 1 s"])
def test_a_limit_with_times_does_not_trip_while_the_profile_stands(tmp_path, sentence):
    with bench_with(tmp_path, sentence) as bench:
        bench.ticks(30)
        bench.ask(Verb.HOLD)
        bench.rig.readings["T_heater"] = 65.0
        bench.ticks(10)
        assert not tripped(bench) and bench.state == "held"
        bench.ask(Verb.RESUME)
        bench.ticks(3)
        assert tripped(bench)


def test_a_lower_limit_holds_while_the_outputs_are_those_of_the_profile_alone(tmp_path):
    with bench_with(tmp_path, "heater_power > 100 W while cycle_counter > 20") as bench:
        bench.ticks(30)
        bench.ask(Verb.PAUSE)
        bench.ticks(20)
        assert bench.rig.heater_W == 0.0 and not tripped(bench)
        bench.ask(Verb.ACK)
    with bench_with(tmp_path, "heater_power > 100 W while cycle_counter > 20") as bench:
        bench.ticks(30)
        bench.ask(Verb.HOLD)
        bench.rig.readings["heater_power"] = 50.0
        bench.ticks(2)
        assert tripped(bench)
