"""Each kind of interlock and each way out, on the real engine with a simulated rig: the heater ends safe in time."""

from __future__ import annotations

import pytest

from drivers.rig_file.interlock_specs import LimitSpec
from drivers.signals.points import Quality
from hil.run.engine.operator import Verb
from hil.run.interlocks.conditions import RigRestart, TickValues
from tests.hil.engine_bench import EngineBench
from tests.hil.simulated_rig import rig_with

WAITS_S = 1000.0


def warm(bench: EngineBench) -> None:
    bench.ticks(30)
    assert bench.state == "running"
    assert bench.rig.heater_W == pytest.approx(700.0)


def hot_sensor(bench: EngineBench) -> None:
    bench.rig.readings["T_heater"] = 80.0


def open_sensor(bench: EngineBench) -> None:
    bench.rig.quality["T_heater"] = Quality.SENSOR_FAULT


def stale_sensor(bench: EngineBench) -> None:
    bench.rig.quality["T_heater"] = Quality.STALE


def no_flow(bench: EngineBench) -> None:
    bench.rig.readings["flow"] = 0.0


def flow_not_known(bench: EngineBench) -> None:
    bench.rig.quality["flow"] = Quality.SENSOR_FAULT


def heater_does_not_follow(bench: EngineBench) -> None:
    bench.rig.readings["heater_power"] = 350.0


def rig_stands_still(bench: EngineBench) -> None:
    bench.rig.counts = False


def thermostat(bench: EngineBench) -> None:
    bench.rig.water_C = 80.0


def reboot(bench: EngineBench) -> None:
    bench.rig.reboot()


def link_lost(bench: EngineBench) -> None:
    bench.rig.link = False


ALARMS = {
    hot_sensor: (1, "T_heater is 80.00 degC"),
    open_sensor: (6, "T_heater has been without a good value for 5 s: sensor fault"),
    stale_sensor: (6, "T_heater has been without a good value for 5 s: stale"),
    no_flow: (3, "heat without flow: heater_power is 700 W, flow is 0.00, at least 0.5 is needed"),
    flow_not_known: (6, "flow has been without a good value"),
    heater_does_not_follow: (4, "heater_power_set asks for 700 W, heater_power is 350 W"),
    rig_stands_still: (11, "the rig has stopped: cycle_counter has not advanced for 10 s"),
    thermostat: (1, "the rig tripped by itself"),
    reboot: (1, "the rig has restarted: plc_uptime went back from"),
    link_lost: (6, "has been without a good value for 5 s: link fault (plc: no answer)"),
}


@pytest.mark.parametrize("fault", ALARMS, ids=lambda fault: fault.__name__)
def test_an_alarm_is_latched_in_time_and_nothing_heats_any_more(fault):
    within, said = ALARMS[fault]
    with EngineBench(rig_with(WAITS_S)) as bench:
        warm(bench)
        fault(bench)
        bench.ticks(within - 1)
        assert bench.state == "running"
        bench.ticks(1)
        assert bench.state == "paused"
        assert said in bench.engine.status().trips[0]
        bench.ticks(20)
        assert bench.rig.heater_W == 0.0
        assert bench.state == "paused"
        assert not bench.violations


def test_a_temperature_that_rises_too_fast_trips():
    with EngineBench(rig_with(WAITS_S)) as bench:
        warm(bench)
        for second in range(4):
            bench.rig.readings["T_pm1"] = 30.0 + 3.0 * second
            bench.ticks()
        assert "T_pm1 rises by 2.25 degC/s, at most 2 is allowed" in bench.engine.status().trips[0]
        assert bench.rig.heater_W == 0.0


@pytest.mark.parametrize("fault", ALARMS, ids=lambda fault: fault.__name__)
def test_a_trip_ends_the_run_where_nobody_is_waited_for(fault):
    within, said = ALARMS[fault]
    with EngineBench(rig_with(0.0)) as bench:
        warm(bench)
        fault(bench)
        bench.ticks(within)
        assert bench.state == "faulted"
        assert said in bench.outcome.reason
        # A meter that still reads 350 W contradicts what is read back: nobody may call that safe.
        assert bench.outcome.safe == (fault not in (link_lost, heater_does_not_follow))
        assert not bench.violations
        bench.rig.pass_time(11.0)
        assert bench.rig.heater_W == 0.0


def test_a_trip_is_acknowledged_when_its_cause_is_gone_and_then_the_run_is_resumed():
    with EngineBench(rig_with(WAITS_S)) as bench:
        warm(bench)
        before = bench.engine.status().profile_s
        hot_sensor(bench)
        bench.ticks(2)
        assert "tripped: T_heater is 80.00 degC" in bench.ask(Verb.RESUME)
        assert bench.ask(Verb.ACK) == ""
        bench.ticks(4)  # still hot
        assert bench.engine.status().trips
        del bench.rig.readings["T_heater"]
        bench.ticks(5)
        assert bench.engine.status().trips  # latched
        bench.ask(Verb.ACK)
        bench.ticks(2)
        assert not bench.engine.status().trips
        assert bench.state == "paused" and bench.engine.status().reason.startswith("trip acknowledged (")
        assert bench.ask(Verb.RESUME) == f"running at {before:g} s of the profile"
        assert bench.rig.heater_W == pytest.approx(100.0)  # through the slew rate of 100 W/s
        assert not bench.violations


@pytest.mark.parametrize("fault", [thermostat, link_lost])
def test_a_rig_that_tripped_by_itself_is_armed_again_by_the_acknowledgement_only(fault):
    with EngineBench(rig_with(WAITS_S)) as bench:
        warm(bench)
        fault(bench)
        bench.ticks(20)
        bench.rig.link, bench.rig.water_C = True, 40.0
        bench.ticks(20)
        assert not bench.rig.armed
        assert bench.rig.heater_W == 0.0
        bench.ask(Verb.ACK)
        bench.ticks(3)
        assert not bench.engine.status().trips
        assert bench.rig.armed
        assert bench.rig.heater_W == 0.0
        bench.ask(Verb.RESUME)
        bench.ticks(8)
        assert bench.rig.heater_W == pytest.approx(700.0)


def test_a_trip_that_nobody_acknowledges_in_time_ends_the_run():
    with EngineBench(rig_with(60.0)) as bench:
        warm(bench)
        hot_sensor(bench)
        bench.ticks(61)
        assert bench.state == "paused"
        bench.ticks(2)
        assert (bench.state, bench.outcome.safe) == ("faulted", True)
        assert "not acknowledged within 60 s" in bench.outcome.reason


@pytest.mark.parametrize(("what", "value", "well"), [("T_tank", 62.0, 59.0), ("residual", 5.0, 2.0)])
def test_a_warning_suspends_and_resumes_by_itself_below_its_deadband_after_its_settle_time(what, value, well):
    def put(now: float) -> None:
        if what == "residual":
            bench.residuals = {("static", "T_tank"): now}
        else:
            bench.rig.readings[what] = now

    with EngineBench(rig_with()) as bench:
        warm(bench)
        profile_s = bench.engine.status().profile_s
        put(value)
        bench.ticks(1)
        assert bench.state == "suspended"
        assert bench.rig.heater_W == 0.0
        put(well)  # within the limit, not by the deadband
        bench.ticks(30)
        assert bench.state == "suspended"
        assert "by itself" in bench.ask(Verb.RESUME)
        put(0.5)
        bench.ticks(5)
        assert bench.state == "suspended"
        bench.ticks(1)
        assert bench.state == "running"
        assert bench.engine.status().profile_s == profile_s
        assert bench.rig.heater_W == pytest.approx(100.0)


def test_hold_keeps_the_outputs_pause_makes_them_safe_and_the_profile_waits():
    with EngineBench(rig_with()) as bench:
        warm(bench)
        before = bench.engine.status().profile_s
        assert bench.ask(Verb.HOLD) == f"held at {before:g} s of the profile"
        bench.ticks(50)
        assert bench.rig.heater_W == pytest.approx(700.0)
        assert bench.ask(Verb.PAUSE).startswith(f"paused at {before:g} s of the profile; safe values read back")
        assert bench.rig.heater_W == 0.0
        bench.ticks(50)
        assert bench.rig.armed  # the heartbeat goes on
        assert "cannot hold" in bench.ask(Verb.HOLD)
        bench.ask(Verb.RESUME)
        heat = []
        for _ in range(7):
            heat.append(bench.rig.heater_W)
            bench.ticks()
        assert heat == pytest.approx([100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0])
        assert bench.engine.status().profile_s == before + 7


def test_a_warning_during_a_hold_does_not_let_the_run_go_on_by_itself():
    with EngineBench(rig_with()) as bench:
        warm(bench)
        bench.ask(Verb.HOLD)
        bench.rig.readings["T_tank"] = 62.0
        bench.ticks(1)
        assert (bench.state, bench.rig.heater_W) == ("paused", 0.0)
        del bench.rig.readings["T_tank"]
        bench.ticks(20)
        assert bench.state == "paused"


def test_a_link_that_comes_back_soon_goes_on_where_it_was_and_no_faster_than_the_slew_rate():
    with EngineBench(rig_with(interlocks=())) as bench:
        bench.ticks(3)
        bench.rig.link = False
        bench.ticks(4)
        bench.rig.link = True
        before = bench.rig.heater_W
        bench.ticks(1)
        assert bench.rig.heater_W <= before + 100.0


def test_safe_values_that_the_rig_does_not_take_are_tried_again_without_heartbeat():
    with EngineBench(rig_with()) as bench:
        warm(bench)
        bench.rig.loses_writes = True
        assert "NOT confirmed safe" in bench.ask(Verb.PAUSE)
        beat = bench.rig.beat
        bench.ticks(1)
        assert bench.rig.beat == beat
        bench.rig.loses_writes = False
        bench.ticks(1)
        assert bench.rig.heater_W == 0.0
        assert bench.rig.beat != beat


@pytest.mark.parametrize(("sensor", "quality"), [("T_tank", Quality.GOOD), ("T_pm4", Quality.SENSOR_FAULT)])
def test_what_has_tripped_already_refuses_the_start_by_name(sensor, quality, monkeypatch):
    rig = rig_with(interlocks=(LimitSpec(kind="limit", level="alarm", point="T_tank", high=20.0),))
    if quality != Quality.GOOD:
        rig = rig_with()
        monkeypatch.setattr("tests.hil.simulated_rig.START_QUALITY", {sensor: quality})
    with EngineBench(rig) as bench:
        assert bench.state == "faulted"
        assert bench.outcome.reason.startswith(f"not started: {sensor} ")
        assert not bench.rig.armed


@pytest.mark.parametrize(("bits", "refused"), [(2, False), (4, True), (6, True)])
def test_a_trip_of_the_rigs_own_must_be_acknowledged_before_the_start_but_for_its_watchdogs(bits, refused, monkeypatch):
    monkeypatch.setattr("tests.hil.simulated_rig.START_TRIPS", bits)
    with EngineBench(rig_with()) as bench:
        bench.ticks(5)
        assert (bench.state, bench.rig.armed) == (("faulted", False) if refused else ("running", True))
        if refused:
            assert f"not started: the rig tripped by itself before (plc_status is {bits})" in bench.outcome.reason
            assert "--rearm" in bench.outcome.reason
    with EngineBench(rig_with(), rearm=True) as bench:
        bench.ticks(5)
        assert (bench.state, bench.rig.armed) == ("running", True)


def test_a_rig_that_restarted_while_its_link_was_lost_is_not_taken_for_the_same():
    with EngineBench(rig_with(WAITS_S)) as bench:
        warm(bench)
        bench.rig.link = False
        bench.ticks(2)
        bench.rig.reboot()
        bench.rig.link = True
        bench.ticks(1)
        assert (bench.state, bench.rig.heater_W) == ("paused", 0.0)
        assert "the rig has restarted" in bench.engine.status().trips[0]
        bench.ask(Verb.ACK)
        bench.ticks(3)
        bench.ask(Verb.RESUME)
        bench.ticks(8)
        assert bench.rig.heater_W == pytest.approx(700.0)
        bench.rig.reboot()
        bench.ticks(1)
        assert bench.state == "paused"
        bench.ask(Verb.ABORT)
        bench.ticks(2)
        assert bench.outcome.restarts == 2


def test_a_clock_that_passes_the_end_of_its_range_is_no_restart():
    seen = RigRestart(rig_with().get("cycle_counter"))
    values = [65000.0, 65535.0, 3.0, 40000.0, 39000.0]
    said = [seen.judge(TickValues(0.0, {"cycle_counter": v}, {"cycle_counter": 0}, {}), False) for v in values]
    assert [text is not None for text in said] == [False, False, False, False, True]


def test_a_warning_that_does_not_go_away_ends_the_run_after_a_time():
    with EngineBench(rig_with(suspend_at_most_s=30.0)) as bench:
        warm(bench)
        bench.rig.readings["T_tank"] = 62.0
        bench.ticks(31)
        assert bench.state == "suspended"
        bench.ticks(1)
        assert (bench.state, bench.outcome.safe) == ("faulted", True)
        assert bench.outcome.reason.endswith("suspended for longer than 30 s")
        assert "T_tank is 62.00 degC" in bench.outcome.reason


def test_an_abort_a_bug_and_a_full_disk_end_safe():
    with EngineBench(rig_with()) as aborted:
        warm(aborted)
        assert "safe values read back" in aborted.ask(Verb.ABORT)
        assert (aborted.state, aborted.outcome.safe, aborted.rig.heater_W) == ("aborted", True, 0.0)
    with EngineBench(rig_with()) as buggy:
        warm(buggy)
        buggy.bug = ZeroDivisionError("a bug")
        buggy.ticks(1)
        assert (buggy.state, buggy.rig.heater_W) == ("faulted", 0.0)
    with EngineBench(rig_with()) as full:
        warm(full)
        full.journal.broken = True
        full.ticks(1)
        assert (full.state, full.outcome.safe, full.rig.heater_W) == ("faulted", True, 0.0)


def test_a_meter_that_has_just_been_told_has_its_time_to_follow():
    with EngineBench(rig_with(WAITS_S)) as bench:
        warm(bench)
        bench.rig.readings["heater_power"] = 700.0
        said = bench.ask(Verb.PAUSE)
        assert "safe values read back, heater_power reads 700.0 W and has " in said and "s to come down to " in said
        assert "but" not in said
        bench.ticks(40)
        assert "heater_power still reads 700.0 W" in bench.engine.status().not_safe
