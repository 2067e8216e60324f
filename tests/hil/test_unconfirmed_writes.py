"""A rig that answers readings and confirms no write: nobody may take it for one that obeys, or for one that is safe."""

from __future__ import annotations

import pytest

from drivers.signals.points import LinkError, Quality
from hil.run.engine.operator import Verb
from tests.hil.engine_bench import EngineBench
from tests.hil.simulated_rig import SHIPPED, rig_with

ABORT_S = round(SHIPPED.abort_after_s)
SETPOINT = "heater_power_set"


def unwatched(bench: EngineBench) -> None:
    """Take the rig's own watchdog away."""
    bench.rig.registers.supervise = lambda now, water_C: None  # type: ignore[method-assign]


def recorded(bench: EngineBench) -> list[tuple[float, int]]:
    """Return value and quality of the heater's set-point in the journal, row by row."""
    place = len(bench.rig.points) + [point.name for point in SHIPPED.setpoints].index(SETPOINT)
    return [(row[4][place], row[5][place]) for row in bench.journal.samples]


def test_writes_that_nobody_answers_trip_though_every_reading_is_good():
    with EngineBench(rig_with(0.0, interlocks=())) as bench:
        bench.ticks(30)
        unwatched(bench)
        bench.rig.drops_writes = True
        bench.ticks(ABORT_S + 3)
        assert bench.state == "faulted"
        assert bench.outcome.reason.startswith(f"the rig has not confirmed its set-points for {ABORT_S} s: plc: no")
        assert not bench.outcome.safe and "look at it now" in bench.outcome.problems[0]


def test_a_pause_that_is_not_confirmed_is_refused_and_the_run_ends():
    with EngineBench(rig_with(1000.0, interlocks=())) as bench:
        bench.ticks(30)
        unwatched(bench)
        bench.rig.drops_writes = True
        said = bench.ask(Verb.PAUSE)
        assert said.startswith("refused: paused at ") and "NOT confirmed safe" in said
        bench.ticks(ABORT_S + 3)
        assert bench.state == "faulted"
        assert bench.outcome.reason.startswith("not confirmed safe for ") and not bench.outcome.safe


def test_a_write_that_was_obeyed_and_not_confirmed_is_recorded_as_the_rig_holds_it():
    with EngineBench(rig_with(0.0, interlocks=())) as bench:
        bench.ticks(3)
        bench.rig.confirms = False
        bench.ticks(3)
        assert recorded(bench)[-1] == (pytest.approx(bench.rig.registers.holding[0] / 10.0), 0)
        assert bench.rig.heater_W > 0.0
        bench.ticks(ABORT_S)
        assert bench.state == "faulted" and "no answer to a write" in bench.outcome.reason


def test_what_cannot_be_asked_for_is_recorded_as_not_known(monkeypatch):
    with EngineBench(rig_with(0.0, interlocks=())) as bench:
        bench.ticks(3)
        bench.rig.drops_writes = True

        async def mute(names: tuple[str, ...]) -> dict[str, float]:
            bench.rig.pass_time(0.1)
            raise LinkError("plc: no answer")

        with monkeypatch.context() as patch:
            patch.setattr(bench.rig, "read_back", mute)
            bench.ticks(2)
            assert recorded(bench)[-1][1] != 0
        bench.rig.drops_writes = False
        bench.ticks(2)
        assert recorded(bench)[-1][1] == 0


def test_a_start_that_is_refused_names_a_heater_that_is_on(monkeypatch):
    monkeypatch.setattr("tests.hil.simulated_rig.START_HEATER_W", 800.0)
    monkeypatch.setattr("tests.hil.simulated_rig.START_QUALITY", {"T_heater": Quality.SENSOR_FAULT})
    with EngineBench(rig_with(0.0)) as bench:
        bench.ticks(2)
        assert bench.state == "faulted" and bench.outcome.reason.startswith("not started: ")
        assert bench.outcome.problems[0].startswith("heater_power still reads 800.0 W")
