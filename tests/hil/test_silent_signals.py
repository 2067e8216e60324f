"""Signals of a run without a single good value."""

from __future__ import annotations

from types import SimpleNamespace

from drivers.signals import Quality, Snapshot
from hil.run.engine.recording import Position, Recorder


def test_the_places_of_points_without_a_good_value_are_known_at_the_end():
    journal = SimpleNamespace(sample=lambda *_: None, check=lambda: None, behind_s=0.0, backlog=0, failure=None)
    recorder = Recorder(journal, Position(1.0))
    assert not recorder.silent
    good, bad = int(Quality.GOOD), int(Quality.LINK_FAULT)
    for quality in ([good, bad, bad], [bad, bad, bad], [bad, good, bad]):
        recorder.sample(Snapshot([1.0, 2.0, 3.0], quality, [0.0] * 3), {"set": 1.0}, 0.0, 0.0, 0.0)
    assert recorder.silent == {2}
