"""Tests of live runs: verdicts as they come, trips by way of the interlocks, and a run that needs no test."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence

import pytest

from drivers.signals.points import Quality
from hil.journal import JournalReader
from hil.run.interlocks import GuardedWatch, TickValues
from hil.run.session import RunRequest, run_session
from hil.run_folder import Labels, read_verdict
from hil.testing import LiveTest, bind, read_plan
from tests.docs.fences import PROJECT
from tests.hil.command_line import typed
from tests.hil.made_plan import SIGNALS, known, plan_text

LOAD = "time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,400,100,70\n60,400,100,70\n"
TRIP = "test small: limit L1"


def live(tmp_path, *sentences: str, head: str = 'trip_on = "major"', more: str = "") -> tuple[LiveTest, list[str]]:
    path, lines = tmp_path / "plan.toml", []
    path.write_text(plan_text(*sentences, head=head, more=more), encoding="utf-8")
    plan = read_plan(path)
    return LiveTest(plan, bind(plan, known()), SIGNALS, 1.0, lines.append), lines


def fed(test: LiveTest, tank: Sequence[float], quality: int = 0, first: int = 0) -> list[str | None]:
    """Return the reasons to trip of ticks with these temperatures of the tank."""
    said = []
    for tick, value in enumerate(tank, first):
        row = [100.0, 5.0, value, 20.0, 20.0, float(tick), 100.0]
        said.append(test.tick(float(tick), row, [0, 0, quality, 0, 0, 0, 0]))
    return said


def test_a_value_beyond_its_limit_is_shown_once_and_trips_while_it_lasts(tmp_path):
    test, lines = live(tmp_path, "T_tank_C < 50")
    said = fed(test, [40.0, 51.0, 52.0, 40.0])
    assert [reason is not None for reason in said] == [False, True, True, False]
    assert said[1] is not None and said[1].startswith(f"{TRIP} (T_tank_C < 50) failed: 51 °C")
    assert len(lines) == 1 and "FAIL" in lines[0]


def test_a_limit_below_the_severity_is_shown_and_trips_nothing(tmp_path):
    test, lines = live(tmp_path, "T_tank_C < 50", more='severity = "minor"')
    assert fed(test, [60.0]) == [None]
    assert len(lines) == 1
    silent, _ = live(tmp_path, "T_tank_C < 50", head="")
    assert fed(silent, [60.0]) == [None]


def test_a_value_that_is_not_good_breaks_no_limit(tmp_path):
    test, lines = live(tmp_path, "T_tank_C < 50")
    assert fed(test, [327.0], int(Quality.SENSOR_FAULT)) == [None]
    assert not lines


def test_time_beyond_a_threshold_adds_up(tmp_path):
    test, _ = live(tmp_path, "time of T_tank_C above 50 < 4 s")
    assert [s is not None for s in fed(test, [60.0, 40.0, 60.0, 60.0, 60.0, 60.0])] == [False] * 4 + [True, True]
    longest, _ = live(tmp_path, "longest time of T_tank_C above 50 < 3 s")
    assert [s is not None for s in fed(longest, [40, 60, 60, 40, 60, 60, 60, 40])] == [False] * 6 + [True, False]


@pytest.mark.parametrize("condition", ["", " while heater_power_W > 50"])
@pytest.mark.parametrize("broken", ["unknown", "not counted", "never read"])
def test_the_longest_time_live_is_that_of_ticks_that_follow_each_other(tmp_path, condition, broken):
    test, lines = live(tmp_path, f"longest time of T_tank_C above 50 < 5 s{condition}")
    for tick in range(8):
        if tick == 4 and broken == "never read":
            continue
        quality = int(Quality.SENSOR_FAULT) if tick == 4 and broken == "unknown" else 0
        power, tank = (0.0, 40.0) if tick == 4 and broken == "not counted" else (100.0, 60.0)
        row = [power, 5.0, tank, 20.0, 20.0, float(tick), 100.0]
        assert test.tick(float(tick), row, [0, 0, quality, 0, 0, 0, 0]) is None
    assert not lines
    assert test.tick(8.0, [100.0, 5.0, 60.0, 20.0, 20.0, 8.0, 100.0], [0] * 7) is None
    assert test.tick(9.0, [100.0, 5.0, 60.0, 20.0, 20.0, 9.0, 100.0], [0] * 7) is not None


def test_times_and_conditions_are_kept_live(tmp_path):
    test, _ = live(tmp_path, "T_tank_C < 50 from 2 s to 4 s")
    assert [s is not None for s in fed(test, [60.0, 60.0, 40.0, 60.0, 40.0, 60.0])] == [False] * 3 + [
        True,
        False,
        False,
    ]
    test, _ = live(tmp_path, "T_tank_C < 50 while cycles > 2")
    assert [s is not None for s in fed(test, [60.0] * 4)] == [False, False, False, True]


def test_a_limit_with_times_is_judged_when_these_are_over(tmp_path):
    test, lines = live(tmp_path, "mean of T_tank_C < 50 before 3 s", "mean of T_tank_C > 50 from 4 s to 6 s")
    said = fed(test, [40.0, 40.0, 40.0, 40.0, 40.0, 40.0, 40.0, 40.0])
    assert [line.split()[6] for line in lines] == ["pass", "FAIL"]
    assert [tick for tick, reason in enumerate(said) if reason] == [6]


def test_a_watch_that_fails_is_taken_off_and_harms_nothing():
    class Broken:
        def tick(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> str | None:
            raise ZeroDivisionError("in the test")

        standing = tick

    notes: list[tuple[str, str]] = []
    guarded = GuardedWatch(Broken(), lambda level, text: notes.append((level, text)))
    for _ in range(3):
        guarded.tick(0.0, [], [])
    assert guarded.judge(TickValues(0.0, {}, {}, {}), False) is None
    assert len(notes) == 1 and "ZeroDivisionError" in notes[0][1]


def test_a_violation_is_handed_to_the_interlocks_once():
    class Tripping:
        def tick(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> str | None:
            return "too hot"

        standing = tick

    guarded = GuardedWatch(Tripping(), lambda level, text: None)
    guarded.tick(0.0, [], [])
    tick = TickValues(0.0, {}, {}, {})
    assert guarded.judge(tick, False) == "too hot"
    assert guarded.judge(tick, True) is None  # so that it can be acknowledged when its cause is gone


@pytest.fixture(scope="module")
def tripped(tmp_path_factory):
    """A run in lockstep without a twin that a critical limit trips after some 30 s, with its lines."""
    folder, lines = tmp_path_factory.mktemp("tripped"), []
    (folder / "load.csv").write_text(LOAD, encoding="utf-8")
    text = plan_text("T_heater_C < 5 after 20 s", "no trip", "heater_power < 500 W", head='trip_on = "critical"')
    text = text.replace('"REQ-1"', '"REQ-1"\nseverity = "critical"').replace("T_heater_C < 5", "heater_power < 300 W")
    (folder / "plan.toml").write_text(text, encoding="utf-8")
    request = RunRequest(
        profile=folder / "load.csv",
        rig=PROJECT / "profiles/rigs/virtual.toml",
        twin=None,
        runs=folder,
        virtual=True,
        mode="lockstep",
        use_twin=False,
        viewer=False,
        test=folder / "plan.toml",
        labels=Labels("Pump <unit>", "0042", "J. Doe", ("night",)),
    )
    return asyncio.run(run_session(request, announce=lines.append)), lines


def test_a_severe_failure_trips_the_run_and_leaves_the_rig_safe(tripped):
    result, lines = tripped
    assert result.outcome.status == "faulted" and result.outcome.safe
    assert result.outcome.reason.startswith(f"{TRIP} (heater_power < 300 W after 20 s) failed: ")
    assert 20.0 <= result.duration_s < 25.0
    assert any("FAIL" in line and "L1" in line for line in lines)
    reader = JournalReader(result.folder.journal)
    try:
        last = reader.states()[-2:]
    finally:
        reader.close()
    assert [row.target for row in last] == ["finishing", "faulted"]


def test_the_files_of_a_tripped_run_have_its_verdict(tripped):
    result, _ = tripped
    limits = read_verdict(result.folder)["tests"][0]["limits"]
    assert [limit["verdict"] for limit in limits] == ["fail", "inconclusive", "inconclusive"]  # no protection tripped
    manifest = result.folder.read_manifest()
    assert manifest["verdict"] == "fail" and not manifest["missing"]
    assert "test" in manifest["files"] and result.folder.junit.is_file()
    page = result.folder.report.read_text(encoding="utf-8")
    assert "Pump &lt;unit&gt;" in page and "0042" in page and "FAILED" in page


def test_a_judgement_of_the_record_is_the_same(tripped):
    result, _ = tripped
    before = read_verdict(result.folder)["tests"][0]["limits"]
    done = typed("test", result.folder.path.parent / "plan.toml", "--on", result.folder.path, "--json")
    assert done.returncode == 1
    assert json.loads(done.stdout)["tests"][0]["limits"] == before


def test_a_plan_without_profile_or_with_unknown_signals_moves_nothing(tmp_path):
    plan = tmp_path / "plan.toml"
    plan.write_text(plan_text("T_tank_C < 50"), encoding="utf-8")
    done = typed("test", plan, "--virtual", "--lockstep", "--runs", tmp_path / "runs")
    assert done.returncode == 2 and "names no profile to replay" in done.stderr
    (tmp_path / "load.csv").write_text(LOAD, encoding="utf-8")
    plan.write_text(plan_text("T_bank_C < 50", head='profile = "load.csv"'), encoding="utf-8")
    done = typed("test", plan, "--virtual", "--lockstep", "--no-twin", "--runs", tmp_path / "runs")
    assert done.returncode == 2 and "did you mean T_tank_C?" in done.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("name", "verb", "said"), [("cooling_steps", "check", "8 limits"), ("battle_acceptance", "test", "ready to run")]
)
def test_the_shipped_plans_fit_the_virtual_rig(name, verb, said):
    options = ("--virtual", "--check-only") if verb == "test" else ()
    done = typed(verb, PROJECT / f"profiles/tests/{name}.toml", *options)
    assert done.returncode == 0 and said in done.stdout, done.stderr
