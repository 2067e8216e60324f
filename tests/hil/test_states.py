"""The engine under random commands and faults: unless it runs, is held or restored the heater is safe in a second."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from drivers.signals.points import Quality
from hil.journal.states import ENDED, LIVE, TABLE, UNTOUCHED, RunEvent, State, StateMachine, Transition, TransitionError
from hil.run.engine.operator import Verb
from tests.hil.engine_bench import EngineBench, cut_at
from tests.hil.simulated_rig import rig_with

EXAMPLES = 40
VISITED: Counter[str] = Counter()
TAKEN: Counter[tuple[str, str]] = Counter()
SENSORS = ("T_heater", "T_pm1", "T_tank", "flow", "heater_power")


def test_from_every_state_there_is_a_way_to_an_end_and_none_leads_out_of_one():
    for state in State:
        ways = {event: target for (source, event), target in TABLE.items() if source is state}
        if state in ENDED:
            assert not ways
            continue
        assert {RunEvent.ABORT, RunEvent.FAIL} <= set(ways), state
        if state in LIVE | {State.RESTORING}:
            assert ways[RunEvent.ABORT] is ways[RunEvent.FAIL] is State.FINISHING
        if state in UNTOUCHED:
            assert ways[RunEvent.FAIL] is State.FAULTED


def test_a_way_that_is_not_in_the_table_is_refused_and_changes_nothing():
    told: list[Transition] = []
    machine = StateMachine(told.append)
    with pytest.raises(TransitionError, match="idle knows no resume"):
        machine.take(RunEvent.RESUME, "why not")
    assert machine.state is State.IDLE
    assert not told


class Steered(RuleBasedStateMachine):
    """One run; rules are what operators do to it, and warnings that come and go."""

    bench: EngineBench

    @initialize(wait_s=st.sampled_from([0.0, 30.0, 500.0, 500.0]), duration_s=st.sampled_from([20.0, 400.0]))
    def start(self, wait_s, duration_s):
        self.bench = EngineBench(rig_with(wait_s), duration_s)

    @rule(count=st.integers(1, 15))
    def time_passes(self, count):
        self.bench.ticks(count)

    @rule(verb=st.sampled_from([Verb.HOLD, Verb.PAUSE, Verb.RESUME, Verb.ACK]))
    def an_operator_asks(self, verb):
        self.bench.ask(verb)

    @rule(ticks=st.integers(0, 12))
    def the_tank_is_warm_for_a_while(self, ticks):
        self.bench.rig.readings["T_tank"] = 62.0
        self.bench.ticks(2)
        self.bench.rig.readings["T_tank"] = 50.0
        self.bench.ticks(ticks)

    @rule()
    def all_is_well_again(self):
        rig = self.bench.rig
        rig.readings.clear()
        rig.quality.clear()
        rig.link, rig.loses_writes, rig.counts, rig.water_C = True, False, True, 40.0
        self.bench.residuals = {}
        self.bench.ticks(6)

    @rule(off_K=st.sampled_from([0.0, 5.0]))
    def the_twin_is_off(self, off_K):
        self.bench.residuals = {("static", "T_tank"): off_K}

    @invariant()
    def the_heater_is_safe(self):
        if hasattr(self, "bench"):
            assert not self.bench.violations, self.bench.violations[0]

    def teardown(self):
        if not hasattr(self, "bench"):
            return
        bench = self.bench
        bench.end()
        rig = bench.rig
        for row in bench.journal.states:
            TAKEN[row[3], row[4]] += 1
        VISITED.update({row[5] for row in bench.journal.states})
        assert bench.state in ENDED
        rig.link, rig.loses_writes, before = True, False, rig.now
        rig.pass_time(11.0)  # what could not be reached the watchdog has cut
        assert rig.heater_W == 0.0, (bench.state, before)


class Run(Steered):
    """One run; rules are what operators, sensors, links and the rig do to it."""

    @rule(times=st.integers(1, 2))
    @precondition(lambda self: self.bench.engine.tick > 20)
    def a_stop_is_asked_for(self, times):
        for _ in range(times):
            self.bench.engine.request_stop("SIGTERM")

    @rule(sensor=st.sampled_from(("T_heater", "T_pm1", "T_tank")), value=st.sampled_from([30.0, 45.0, 62.0, 80.0]))
    def a_temperature_moves(self, sensor, value):
        self.bench.rig.readings[sensor] = value

    @rule(sensor=st.sampled_from(SENSORS), quality=st.sampled_from(list(Quality)))
    def a_sensor_fails_or_recovers(self, sensor, quality):
        self.bench.rig.quality[sensor] = quality

    @rule(flow=st.sampled_from([0.0, 3.8]))
    def the_flow_stops_or_returns(self, flow):
        self.bench.rig.readings["flow"] = flow

    @rule(stuck=st.booleans())
    def the_heater_sticks_or_follows(self, stuck):
        self.bench.rig.readings.pop("heater_power", None)
        if stuck:
            self.bench.rig.readings["heater_power"] = 350.0

    @rule(up=st.booleans(), ticks=st.integers(0, 14))
    def the_link_drops_or_returns(self, up, ticks):
        self.bench.rig.link = up
        self.bench.ticks(ticks)

    @rule(loses=st.booleans())
    def writes_are_lost_without_a_word(self, loses):
        self.bench.rig.loses_writes = loses

    @rule(counts=st.booleans())
    def the_rigs_program_stops_or_goes_on(self, counts):
        self.bench.rig.counts = counts

    @rule()
    def the_rig_reboots(self):
        self.bench.rig.reboot()

    @rule(water_C=st.sampled_from([40.0, 80.0]))
    def the_thermostat_sees(self, water_C):
        self.bench.rig.water_C = water_C

    @rule(broken=st.booleans())
    @precondition(lambda self: self.bench.engine.tick > 40)
    def the_disk_fills_or_is_freed(self, broken):
        self.bench.journal.broken = broken

    @rule()
    @precondition(lambda self: self.bench.engine.tick > 60)
    def there_is_a_bug(self):
        self.bench.bug = ZeroDivisionError("a bug")


class Cut:
    """A run that goes on after a cut, when the rig was at `aim_C`; until something happens it is at 30 degC."""

    @initialize(wait_s=st.sampled_from([0.0, 500.0]), aim_C=st.sampled_from([30.0, 50.0]))
    def start(self, wait_s, aim_C):
        self.bench = EngineBench(rig_with(wait_s), 400.0, cut_at(10.0, dict.fromkeys(("T_heater", "T_tank"), aim_C)))

    @rule(ticks=st.integers(50, 70))
    def the_rig_is_warm_for_long(self, ticks):
        self.bench.rig.readings |= {"T_heater": 50.0, "T_tank": 50.0}
        self.bench.ticks(ticks)

    @rule(stop=st.sampled_from([Verb.HOLD, Verb.PAUSE]), ticks=st.integers(0, 15))
    def an_operator_stops_it_for_a_while(self, stop, ticks):
        self.bench.ask(stop)
        self.bench.ticks(ticks)
        self.bench.ask(Verb.RESUME)


class CutRun(Cut, Run):
    """Such a run, and whatever may happen to it."""


class SteeredCutRun(Cut, Steered):
    """Such a run, and nothing that ends it soon."""


def test_whatever_happens_the_heater_is_safe_within_a_second_unless_it_runs_is_held_or_led_back():
    for kind, examples in ((Run, EXAMPLES), (CutRun, EXAMPLES // 2), (SteeredCutRun, EXAMPLES // 4)):
        checked = settings(
            derandomize=True,
            phases=[Phase.generate],  # shrinking whole runs takes minutes
            max_examples=examples,
            stateful_step_count=40,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        )
        run_state_machine_as_test(kind, settings=checked)
    assert set(VISITED) >= {state.value for state in State if state is not State.IDLE}
    restoring = {key for key in TABLE if State.RESTORING in (key[0], TABLE[key]) and key[0] not in UNTOUCHED}
    of_operators = {key for key in restoring if key[1] in (RunEvent.HOLD, RunEvent.PAUSE, RunEvent.RESTORE)}
    assert len(of_operators) == 5
    assert of_operators <= set(TAKEN)
    reachable = {key for key in TABLE if key[0] not in UNTOUCHED and key != (State.RESTORING, RunEvent.ABORT)}
    missing = {(s.value, e.value) for s, e in reachable} - set(TAKEN)
    print(f"{sum(TAKEN.values())} transitions in {VISITED['restoring']} runs; not taken: {sorted(missing)}")
    assert len(missing) <= 12  # which ones chance leaves out depends on what else hypothesis has seen
