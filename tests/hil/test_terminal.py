"""What a person sees while something long goes on."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

import hil.run.session.terminal
from hil.diagnosis.live import Reply, interim_finding
from hil.guardian.client import GuardianReport
from hil.run.engine.status import Outcome
from hil.run.session.run import RunResult
from hil.run.session.terminal import ProgressBar, RunProgress, closing_advice, parameter_table
from hil.tracking.twins import Comparison, ErrorTable
from tests.hil.made_diagnosis import SAYS, SENSORS, made


@pytest.fixture
def clock(monkeypatch):
    now = SimpleNamespace(s=0.0)
    monkeypatch.setattr(hil.run.session.terminal, "time", SimpleNamespace(monotonic=lambda: now.s))
    return now


def test_what_a_restore_took_does_not_make_the_rest_look_longer(clock, capsys):
    with ProgressBar("replaying", 100.0, begun=60.0) as steps:
        for _ in range(100):  # it restores for 600 s
            clock.s += 6.0
            steps.update(60.0, "RESTORING  T_tank is 9.0 K below")
        restoring = capsys.readouterr().err.splitlines()
        assert restoring[0].split() == ["replaying:", "60", "%", "RESTORING", "T_tank", "is", "9.0", "K", "below"]
        for done in (70.0, 80.0):
            clock.s += 10.0
            steps.update(done)
    assert ["80 %, ETA 20 s" in line for line in capsys.readouterr().err.splitlines()] == [False, True]


def test_a_path_that_is_told_can_be_pasted(monkeypatch, capsys):
    path = Path("runs") / "a folder with a rather long name" / "20260520T120000Z-battle_40h" / "twin.r2.toml"
    monkeypatch.setenv("COLUMNS", "40")
    with RunProgress() as live:
        live.announce(f"adopted as {path}")
    with ProgressBar("diagnosing", 6.0) as steps:
        steps.print_line(f"adopted as {path}")
    assert capsys.readouterr().err.splitlines() == 2 * [f"adopted as {path}"]
    outcome = Outcome("done", "", safe=True)
    told = Reply(problem="too short", revision=path)
    folder = SimpleNamespace(path=path.parent, review=path.parent / "review.rrd", read_manifest=dict)
    live.show_result(RunResult(folder, outcome, None, 1.0, 1.0, False, told, gates="held [everything] in 6 of 120"))
    out = capsys.readouterr().out
    assert f"revision of the twin: '{path}'\n" in out and "held [everything] in 6 of 120\n" in out


def test_square_brackets_in_reasons_and_paths_are_text(capsys):
    path = Path("runs [old]") / "[/x] load"
    outcome = Outcome("aborted", "[/x] [bold]smoke", ticks=10, safe=True)
    folder = SimpleNamespace(path=path, review=path / "review.rrd", read_manifest=dict)
    with RunProgress() as live:
        live.show_result(RunResult(folder, outcome, None, 1.0, 1.0, False))
    out = capsys.readouterr().out
    assert ": [/x] [bold]smoke\n" in out and f"run folder: {path}\n" in out
    assert f" review '{path}'\n" in out and f" review '{path}' --screenshot" in out and f" resume '{path}'\n" in out


def test_square_brackets_in_a_progress_line_are_text(monkeypatch, capsys):
    monkeypatch.setenv("TTY_COMPATIBLE", "1")  # as in a terminal
    with ProgressBar("replaying [/x]", 100.0) as steps:
        steps.update(50.0, "RESTORING  [/x] is 9 K below")
    said = capsys.readouterr().err
    assert "replaying [/x]" in said and "[/x] is 9 K below" in said


def test_a_run_that_was_diagnosed_ends_with_verdict_errors_and_files(tmp_path, capsys):
    review, page = tmp_path / "review.rrd", tmp_path / "diagnosis" / "diagnosis.html"
    review.touch()
    diagnosis = made()
    told = Reply(interim_finding(diagnosis, 36_000.0), page=page, document=diagnosis.document())
    folder = SimpleNamespace(path=tmp_path, review=review, read_manifest=dict)
    RunProgress().show_result(RunResult(folder, Outcome("done", "", safe=True), None, 1.0, 1.0, False, told))
    out = capsys.readouterr().out
    end = out[out.index(f"effect found: {SAYS}.") :]
    for words in ("free run from 7 h 30 min to 10 h, ", "baseline", "re-tuned", "with the effect", "noise", *SENSORS):
        assert words in end
    assert end.splitlines()[-2:] == [f"diagnosis with pictures: {page}", f"run in Rerun: {review}"]


@pytest.mark.parametrize("status", ["faulted", "aborted"])
def test_the_safety_sentence_comes_last_and_a_resume_only_after_a_look_at_the_rig(status, tmp_path):
    unsafe = closing_advice(Outcome(status, "the link is lost", ticks=10, safe=False), tmp_path)
    assert unsafe[-1].startswith("The rig was NOT confirmed safe: go to the rig now")
    assert "once somebody has seen at the rig that nothing heats" in unsafe[0] and "resume" in unsafe[0]
    safe = closing_advice(Outcome(status, "the link is lost", ticks=10, safe=True), tmp_path)
    assert len(safe) == 1 and "go on with it" in safe[0]
    assert closing_advice(Outcome("done", "", ticks=10, safe=True), tmp_path) == []
    (done,) = closing_advice(Outcome("done", "", ticks=10, safe=True, away="heater still reads 40 W"), tmp_path)
    assert done.startswith("The rig was NOT confirmed safe")


def test_parameters_at_the_end_have_their_units(capsys):
    values = {"static": {"loop.factor": (1.0, None, False)}, "pso": {"loop.factor": (0.9, 0.01, False)}}
    print_to = hil.run.session.terminal.console()
    print_to.print(parameter_table(Comparison(ErrorTable((), {}), parameters=values, units={"loop.factor": "W/K"})))
    out = capsys.readouterr().out
    assert "unit" in out and "W/K" in out


@pytest.mark.parametrize(("safe", "itself"), [(True, True), (False, False)])
def test_a_guardian_without_an_answer_does_not_outlast_a_run_that_is_safe(safe, itself):
    said = GuardianReport("the run hung", False, "plc: no answer in time").sentence(run_is_safe=safe)
    assert said.startswith("the run hung; plc: no answer in time")
    assert ("the run itself has read the safe values back" in said) == itself
