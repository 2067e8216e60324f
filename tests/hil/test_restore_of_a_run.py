"""A run that goes on after a cut, on the real engine with a simulated rig: it heats only for the thermal restore."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from drivers.signals.points import Quality
from hil.journal.profile_clock import profile_times
from hil.journal.rows import StateRow
from hil.journal.states import RunEvent, State
from hil.run.engine.operator import RefusedError, Verb
from hil.run.engine.supervisor import Supervisor
from hil.run.restore.thermal_restore import SETTLE_S
from tests.hil.engine_bench import EngineBench, cut_at
from tests.hil.simulated_rig import SimulatedRig, rig_with

AIM = {"T_heater": 40.0, "T_tank": 38.0}


def there(bench: EngineBench, off_K: float = 0.0) -> None:
    bench.rig.readings |= {name: value + off_K for name, value in AIM.items()}


def test_the_profile_goes_on_once_the_rig_has_been_back_for_a_minute():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        bench.ticks(1)
        status = bench.engine.status()
        assert (bench.state, status.profile_s) == ("restoring", 120.0)
        assert status.time_s == pytest.approx(220.0, abs=2.0)
        assert status.reason == "T_heater is 30.0 degC, 10.0 K below the 40.0 that it had when the run was cut"
        bench.ticks(9)
        assert bench.rig.heater_W == pytest.approx(700.0)  # no more than the profile asks for
        there(bench, 0.9)
        bench.ticks(int(SETTLE_S))
        assert bench.state == "restoring"
        bench.ticks(1)
        assert (bench.state, bench.engine.status().profile_s) == ("running", 120.0)
        bench.ticks(5)
        assert bench.engine.status().profile_s == 125.0
        segment = bench.journal.segments[0]
        assert (segment.number, segment.profile_s, segment.aim_tick) == (2, 120.0, 120)
        assert segment.gap_s == pytest.approx(100.0, abs=2.0)
        assert bench.journal.samples[0][0] == segment.tick


def test_a_rig_that_leaves_the_band_begins_its_minute_again():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        there(bench)
        bench.ticks(50)
        there(bench, 1.1)
        bench.ticks(1)
        there(bench)
        bench.ticks(int(SETTLE_S))
        assert bench.state == "restoring"
        bench.ticks(1)
        assert bench.state == "running"


@pytest.mark.parametrize(("off_K", "heat_W"), [(-10.0, 700.0), (-0.5, 700.0), (1.0, 350.0), (10.0, 0.0)])
def test_a_hotter_rig_gets_less_heat(off_K, heat_W):
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        there(bench, off_K)
        bench.ticks(20)
        assert bench.rig.heater_W == pytest.approx(heat_W, abs=21.0)
        assert not bench.violations


def test_a_rig_that_stays_too_hot_gets_less_and_less_heat():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        there(bench, 1.3)
        bench.ticks(20)
        before = bench.rig.heater_W
        bench.ticks(450)
        assert (before, bench.rig.heater_W) == (pytest.approx(245.0, abs=21.0), 0.0)
        there(bench, -1.3)
        bench.ticks(30)
        assert bench.rig.heater_W == pytest.approx(700.0)


@pytest.mark.parametrize(("resumption", "untouched"), [(None, True), (cut_at(120.0, AIM), False)])
def test_a_resumed_run_that_is_refused_was_not_without_effect_on_the_rig(resumption, untouched):
    """Its earlier part heated, so that nobody may be told that it wrote nothing."""
    rig = rig_with()
    cold = tuple(p.model_copy(update={"alarm": (-5.0, 10.0)}) if p.name == "T_tank" else p for p in rig.point)
    with EngineBench(rig.model_copy(update={"point": cold}), resumption=resumption) as bench:
        bench.ticks(30)
        assert "not started" in bench.outcome.reason and bench.outcome.untouched is untouched


def test_what_is_set_in_watts_and_safe_at_zero_leads_without_a_role():
    rig = rig_with()
    nameless = tuple(p.model_copy(update={"role": None}) for p in rig.point)
    with EngineBench(rig.model_copy(update={"point": nameless}), resumption=cut_at(120.0, AIM)) as bench:
        there(bench, 10.0)
        bench.ticks(20)
        assert bench.rig.heater_W == 0.0
    cooler = tuple(p.model_copy(update={"safe_value": 50.0}) if p.name == "heater_power_set" else p for p in nameless)
    with EngineBench(rig.model_copy(update={"point": cooler}), resumption=cut_at(120.0, AIM)) as bench:
        there(bench, 10.0)
        bench.ticks(20)
        assert bench.rig.heater_W == pytest.approx(700.0)


def test_a_rig_that_does_not_get_there_in_time_is_left_safe():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM, timeout_s=100.0)) as bench:
        bench.ticks(101)
        assert bench.state == "restoring"
        bench.ticks(2)
        assert (bench.state, bench.outcome.safe, bench.rig.heater_W) == ("faulted", True, 0.0)
        assert bench.outcome.reason.startswith(
            "not resumed: after 100 s of thermal restore T_heater is 30.0 degC, 10.0 K below"
        )
        assert bench.outcome.restore_s > 100.0


def test_a_sensor_that_is_lost_is_not_taken_for_one_that_is_back():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        there(bench)
        bench.rig.quality["T_tank"] = Quality.STALE
        bench.ticks(4)
        assert "T_tank has no good value" in bench.engine.status().reason


@pytest.mark.parametrize("wait_s", [0.0, 500.0])
def test_a_trip_ends_the_restore_and_nobody_is_waited_for(wait_s):
    with EngineBench(rig_with(wait_s), resumption=cut_at(120.0, AIM)) as bench:
        bench.ticks(20)
        bench.rig.readings["flow"] = 0.0
        bench.ticks(4)
        assert (bench.state, bench.rig.heater_W) == ("faulted", 0.0)
        assert "heat without flow" in bench.outcome.reason


def test_a_warning_suspends_the_restore_which_goes_on_and_not_the_profile():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        bench.ticks(20)
        bench.residuals = {("static", "T_tank"): 5.0}
        bench.ticks(1)
        assert (bench.state, bench.rig.heater_W) == ("suspended", 0.0)
        assert "by itself" in bench.ask(Verb.RESUME)
        bench.residuals = {}
        bench.ticks(8)
        assert bench.state == "restoring"
        assert bench.engine.status().profile_s == 120.0
        assert not bench.violations


@pytest.mark.parametrize("sensor", ["T_pm4", None])
def test_a_rig_that_still_heats_is_safe_before_anything_else_even_where_the_run_may_not_go_on(sensor, monkeypatch):
    monkeypatch.setattr("tests.hil.simulated_rig.START_HEATER_W", 700.0)
    if sensor is not None:
        monkeypatch.setattr("tests.hil.simulated_rig.START_QUALITY", {sensor: Quality.SENSOR_FAULT})
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        assert bench.rig.heater_W == 0.0
        assert any("safe values written on connecting" in text for _, text in bench.journal.events)
        if sensor is not None:
            assert (bench.state, bench.outcome.safe) == ("faulted", True)
            assert bench.outcome.reason.startswith("not started: T_pm4")


def test_a_pause_makes_a_restore_safe_and_stops_its_clock_and_resume_goes_on_restoring():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM, timeout_s=100.0)) as bench:
        bench.ticks(50)
        assert bench.ask(Verb.RESUME) == "restoring at 120 s of the profile"  # it does already
        assert bench.ask(Verb.PAUSE).startswith("paused at 120 s of the profile; safe values read back")
        assert bench.rig.heater_W == 0.0
        bench.ticks(500)
        assert (bench.state, bench.rig.armed) == ("paused", True)
        assert "cannot hold: its outputs are at their safe values" in bench.ask(Verb.HOLD)
        assert bench.ask(Verb.RESUME) == "restoring at 120 s of the profile"
        heat = []
        for _ in range(7):
            heat.append(bench.rig.heater_W)
            bench.ticks()
        assert heat == pytest.approx([100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0])
        bench.ticks(35)
        assert bench.state == "restoring"  # of its 100 s the pause took none
        bench.ticks(15)
        assert bench.outcome.reason.startswith("not resumed: after 100 s of thermal restore")
        assert not bench.violations
        steps = [(row[3], row[4], row[5], row[6]) for row in bench.journal.states]
        assert ("restoring", "pause", "paused", "by the test") in steps
        assert ("paused", "restore", "restoring", "by the test") in steps


def test_hold_keeps_the_outputs_that_lead_and_stops_the_clock_of_the_restore():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM, timeout_s=100.0)) as bench:
        there(bench, 1.0)
        bench.ticks(20)
        assert bench.ask(Verb.HOLD) == "held at 120 s of the profile"
        there(bench, 10.0)
        bench.ticks(300)
        assert (bench.state, bench.rig.heater_W) == ("held", pytest.approx(350.0, abs=21.0))
        bench.ask(Verb.RESUME)
        bench.ticks(5)
        assert (bench.state, bench.rig.heater_W) == ("restoring", 0.0)
        assert not bench.violations


@pytest.mark.parametrize("verb", [Verb.HOLD, Verb.PAUSE])
def test_a_rig_that_gets_there_while_its_restore_is_stopped_does_not_start_by_itself(verb):
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        there(bench)
        bench.ticks(int(SETTLE_S) - 5)
        bench.ask(verb)
        bench.ticks(200)
        assert (bench.state, bench.engine.status().profile_s) == ({"hold": "held", "pause": "paused"}[verb], 120.0)
        bench.ask(Verb.RESUME)
        bench.ticks(int(SETTLE_S) - 1)
        assert bench.state == "restoring"  # the minute begins anew
        bench.ticks(1)
        assert (bench.state, bench.engine.status().profile_s) == ("running", 120.0)


def test_a_warning_pauses_a_restore_that_is_held_and_one_that_is_active_suspends_its_resume():
    with EngineBench(rig_with(), resumption=cut_at(120.0, AIM)) as bench:
        bench.ticks(20)
        bench.ask(Verb.HOLD)
        bench.residuals = {("static", "T_tank"): 5.0}
        bench.ticks(1)
        assert (bench.state, bench.rig.heater_W) == ("paused", 0.0)
        assert bench.ask(Verb.RESUME).startswith("suspended")
        assert bench.ask(Verb.PAUSE).startswith("paused")
        bench.residuals = {}
        bench.ticks(20)
        assert bench.state == "paused"
        bench.ask(Verb.RESUME)
        assert bench.state == "restoring"
        assert not bench.violations


@pytest.mark.parametrize("first", [None, Verb.HOLD, Verb.PAUSE])
def test_a_restore_is_aborted_whatever_it_is_at(first):
    with EngineBench(rig_with(500.0), resumption=cut_at(120.0, AIM)) as bench:
        bench.ticks(20)
        if first is not None:
            bench.ask(first)
        bench.ask(Verb.ABORT)
        bench.ticks(2)
        assert (bench.state, bench.rig.heater_W) == ("aborted", 0.0)
        assert "takes no verb any more" in bench.ask(Verb.PAUSE)


async def test_what_is_asked_while_a_run_is_armed_is_obeyed_before_anything_moves():
    rig = rig_with()
    points = tuple(point for point in rig.point if point.access == "r")
    supervisor = Supervisor(rig, points, log=lambda step: None, note=lambda level, text: None)
    with pytest.raises(RefusedError, match="a run that is idle can only be aborted"):
        await supervisor.ask(Verb.PAUSE, "too early")
    for event in (RunEvent.VALIDATE, RunEvent.CONNECT, RunEvent.RESTORE):
        supervisor.machine.take(event, "")
    asked = asyncio.create_task(supervisor.ask(Verb.PAUSE, "the tank is open"))
    await asyncio.sleep(0)
    assert not asked.done()
    supervisor.machine.take(RunEvent.START, "armed")
    assert supervisor.step(await SimulatedRig(rig).read(), 0.0, {}, {}) is None
    assert (supervisor.state, supervisor.machine.reason) == (State.PAUSED, "the tank is open")
    supervisor.answer("paused")
    assert await asked == "paused"


def test_a_profile_that_was_over_is_not_run_again():
    with EngineBench(rig_with(), duration_s=120.0, resumption=cut_at(120.0, AIM)) as bench:
        assert (bench.state, bench.outcome.reason, bench.rig.heater_W) == ("done", "", 0.0)


def test_profile_time_is_told_from_the_transitions():
    def row(tick: int, profile_s: float, target: str) -> StateRow:
        return StateRow(0, tick, float(tick), 0.0, profile_s, "", "", target, "")

    states = [
        row(0, 0.0, "running"),
        row(5, 4.0, "held"),
        row(8, 4.0, "running"),
        row(10, 6.0, "idle"),
        row(20, 6.0, "restoring"),
        row(30, 6.0, "running"),
    ]
    ticks = np.array([0, 4, 5, 7, 8, 9, 21, 30, 32])
    assert profile_times(states, ticks, 1.0).tolist() == [0.0, 4.0, 4.0, 4.0, 4.0, 5.0, 6.0, 6.0, 8.0]
