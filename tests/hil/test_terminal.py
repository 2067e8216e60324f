"""What a person sees while something long goes on."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

import hil.terminal
from hil.engine import Outcome
from hil.live_diagnosis import Reply, found_of
from hil.session import RunResult
from hil.terminal import LiveRun, Steps
from tests.hil.made_diagnosis import SAYS, SENSORS, made


@pytest.fixture
def clock(monkeypatch):
    now = SimpleNamespace(s=0.0)
    monkeypatch.setattr(hil.terminal, "time", SimpleNamespace(monotonic=lambda: now.s))
    return now


def test_what_a_soak_took_does_not_make_the_rest_look_longer(clock, capsys):
    with Steps("replaying", 100.0, begun=60.0) as steps:
        for _ in range(100):  # it soaks for 600 s
            clock.s += 6.0
            steps.update(60.0, "SOAKING  T_tank is 9.0 K below")
        soaking = capsys.readouterr().err.splitlines()
        assert soaking[0].split() == ["replaying:", "60", "%", "SOAKING", "T_tank", "is", "9.0", "K", "below"]
        for done in (70.0, 80.0):
            clock.s += 10.0
            steps.update(done)
    assert ["80 %, ETA 20 s" in line for line in capsys.readouterr().err.splitlines()] == [False, True]


def test_a_path_that_is_told_can_be_pasted(monkeypatch, capsys):
    path = Path("runs") / "a folder with a rather long name" / "20260520T120000Z-battle_40h" / "twin.r2.toml"
    monkeypatch.setenv("COLUMNS", "40")
    with LiveRun() as live:
        live.announce(f"adopted as {path}")
    with Steps("diagnosing", 6.0) as steps:
        steps.say(f"adopted as {path}")
    assert capsys.readouterr().err.splitlines() == 2 * [f"adopted as {path}"]
    outcome = Outcome("done", "", safe=True)
    told = Reply(problem="too short", revision=path)
    folder = SimpleNamespace(path=path.parent, review=path.parent / "review.rrd", read_manifest=dict)
    live.show_result(RunResult(folder, outcome, None, 1.0, 1.0, False, told, gates="held [everything] in 6 of 120"))
    out = capsys.readouterr().out
    assert f"revision of the twin: '{path}'\n" in out and "held [everything] in 6 of 120\n" in out


def test_a_run_that_was_diagnosed_ends_with_verdict_errors_and_files(tmp_path, capsys):
    review, page = tmp_path / "review.rrd", tmp_path / "diagnosis" / "diagnosis.html"
    review.touch()
    diagnosis = made()
    told = Reply(found_of(diagnosis, 36_000.0), page=page, document=diagnosis.document())
    folder = SimpleNamespace(path=tmp_path, review=review, read_manifest=dict)
    LiveRun().show_result(RunResult(folder, Outcome("done", "", safe=True), None, 1.0, 1.0, False, told))
    out = capsys.readouterr().out
    end = out[out.index(f"effect found: {SAYS}.") :]
    for words in ("free run from 7 h 30 min to 10 h, ", "as it was", "re-tuned", "with the effect", "noise", *SENSORS):
        assert words in end
    assert end.splitlines()[-2:] == [f"diagnosis with pictures: {page}", f"run in Rerun: {review}"]
