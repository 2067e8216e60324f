"""What a person sees while something long goes on."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

import hil.terminal
from hil.terminal import Steps


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
