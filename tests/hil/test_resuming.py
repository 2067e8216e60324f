"""Where a run stood that was cut, aborted, tripped or paused, told from its journal."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.rig.connection import RigConnection
from drivers.signals.points import Quality
from hil.journal import export_record
from hil.journal.states import RunEvent, State, next_state
from hil.journal.writer import Header, JournalError, JournalWriter
from hil.review import write_review
from hil.run.session.interrupted_run import position_of
from hil.run_folder.folder import RunFolder, RunFolderError, require_room
from hil.run_folder.room import BYTES_OF_ANY_RUN, RunSize
from tests.hil.simulated_rig import SHIPPED
from tests.hil.synthetic_journal import Truth, make, write

SIGNALS = RigConnection(SHIPPED, lambda: 0.0).signals
HOT_C, COOL_C = 45.0, 25.0


class Story:
    """A journal, stretch by stretch; a temperature is `HOT_C` while the run heats and `COOL_C` at safe values."""

    def __init__(self, folder: Path, period_s: float = 1.0) -> None:
        folder.mkdir(exist_ok=True)
        self.folder = RunFolder(folder)
        self.period_s = period_s
        self._journal = JournalWriter(self.folder.journal, Header(SIGNALS, {}, (), "load", 9000.0, period_s, {}))
        self._state, self._tick, self._profile_s = State.RESTORING, 0, 0.0

    def then(self, event: RunEvent, ticks: int, temperature_C: float, bad: tuple[str, ...] = ()) -> Story:
        """Take `event`, then `ticks` at a temperature; `bad` sensors have no good value."""
        target = next_state(self._state, event)
        assert target is not None
        # The tick of the transition has been recorded still as it was.
        at = max(self._tick - 1, 0)
        self._journal.state(at, at * self.period_s, self._profile_s, self._state, event, target, "the test")
        self._state = target
        for tick in range(self._tick, self._tick + ticks):
            self._journal.sample(
                tick,
                tick * self.period_s,
                1e9 + tick * self.period_s,
                0.001,
                [temperature_C if signal.unit == "degC" else 1.0 for signal in SIGNALS],
                [int(Quality.STALE if signal.name in bad else Quality.GOOD) for signal in SIGNALS],
                [0.0] * len(SIGNALS),
            )
            self._profile_s += self.period_s if target is State.RUNNING else 0.0
        self._tick += ticks
        return self

    def end(self) -> RunFolder:
        self._journal.close()
        return self.folder


@pytest.mark.parametrize(
    ("first", "then"),
    [
        (RunEvent.ABORT, ()),  # SIGTERM, SIGINT, `hil ctl abort`
        (RunEvent.FAIL, ()),  # a trip, a lost link, a full disk, a defect
        (RunEvent.PAUSE, ()),  # killed while somebody topped up the tank
        (RunEvent.PAUSE, (RunEvent.ABORT,)),
        (RunEvent.WARN, ()),
        (RunEvent.WARN, (RunEvent.PAUSE, RunEvent.FAIL)),
        (RunEvent.TRIP, (RunEvent.FAIL,)),  # nobody acknowledged it
    ],
)
def test_a_rig_is_restored_to_where_the_profile_left_it_not_to_where_it_cooled_since(tmp_path, first, then):
    story = Story(tmp_path).then(RunEvent.START, 300, HOT_C)
    for event in (first, *then):
        story.then(event, 200 if event is not RunEvent.FAIL else 0, COOL_C)
    found = position_of(story.end())
    assert set(found.aim.values()) == {HOT_C}
    assert len(found.aim) == sum(signal.unit == "degC" and signal.role != "T_ambient" for signal in SIGNALS)
    assert found.profile_s == pytest.approx(300.0, abs=1.0)


def test_what_was_held_is_restored_to_where_the_hold_had_brought_it(tmp_path):
    story = (
        Story(tmp_path)
        .then(RunEvent.START, 300, COOL_C)
        .then(RunEvent.HOLD, 200, HOT_C)
        .then(RunEvent.PAUSE, 100, COOL_C)
    )
    found = position_of(story.end())
    assert set(found.aim.values()) == {HOT_C}
    assert found.profile_s == pytest.approx(300.0, abs=1.0)


@pytest.mark.parametrize("period_s", [0.1, 1.0])
def test_a_sensor_whose_loss_ended_the_run_is_still_restored_to_its_last_good_values(tmp_path, period_s):
    ticks = round(6.0 / period_s)
    story = Story(tmp_path, period_s).then(RunEvent.START, 900, HOT_C)
    story.then(RunEvent.HOLD, 0, HOT_C).then(RunEvent.RESUME, ticks, HOT_C, bad=("T_pm2", "T_tank"))
    found = position_of(story.then(RunEvent.FAIL, 0, COOL_C).end())
    assert found.aim["T_pm2"] == found.aim["T_tank"] == found.aim["T_heater"] == HOT_C


def test_a_sensor_that_was_lost_for_long_is_not_restored_to_what_it_said_long_ago(tmp_path):
    story = Story(tmp_path).then(RunEvent.START, 300, COOL_C).then(RunEvent.HOLD, 120, HOT_C, bad=("T_pm2",))
    found = position_of(story.end())
    assert "T_pm2" not in found.aim
    assert found.aim["T_heater"] == HOT_C


def test_a_run_that_never_had_a_sample_says_so(tmp_path):
    sentence = "ended before its first sample; start a new run"
    with pytest.raises(RunFolderError, match=sentence):
        position_of(RunFolder(tmp_path))
    with pytest.raises(RunFolderError, match=sentence):
        position_of(Story(tmp_path / "a").then(RunEvent.FAIL, 0, COOL_C).end())


def test_a_journal_that_was_cut_while_it_was_made_says_so(tmp_path):
    for name, statement in (("empty", None), ("half", "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)")):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "journal.sqlite"
        path.touch()
        if statement is not None:
            database = sqlite3.connect(path)
            database.execute(statement)
            database.close()
        with pytest.raises(JournalError, match="was cut while it was made, before anything moved"):
            position_of(RunFolder(tmp_path / name))


def test_a_run_that_is_nearly_over_needs_room_for_what_it_lacks_alone(tmp_path, monkeypatch):
    free = BYTES_OF_ANY_RUN + 1_000_000
    monkeypatch.setattr("shutil.disk_usage", lambda path: SimpleNamespace(free=free))
    folder, size = RunFolder(tmp_path), RunSize(10_000, 3)
    with pytest.raises(
        RunFolderError, match=r"has 11 MB free, this run may need 13 MB; free some or move the run's fol"
    ):
        require_room(folder, size)
    folder.review.write_bytes(bytes(2_000_000))  # it stays until the new one is complete
    with pytest.raises(RunFolderError, match="may need 13 MB"):
        require_room(folder, size)
    folder.journal.write_bytes(bytes(2_000_000))
    require_room(folder, size)


def test_the_room_of_a_run_is_enough_for_values_that_no_file_can_shorten(tmp_path):
    ticks, noise = 1500, np.random.default_rng(0)
    header = make(10, twins=("static",)).header
    truth = Truth(
        header,
        np.arange(float(ticks)),
        noise.normal(50.0, 5.0, (ticks, len(header.signals))),
        np.zeros((ticks, len(header.signals)), dtype=np.uint8),
        {"static": noise.normal(50.0, 5.0, (ticks, len(header.twin_sensors)))},
    )
    folder = RunFolder(tmp_path)
    write(folder.journal, truth)
    export_record(folder.journal, folder.record)
    write_review(folder.journal, folder.review)
    size = RunSize(ticks, len(header.signals), 1, len(header.twin_sensors))
    for_ticks = size.bytes_needed - BYTES_OF_ANY_RUN
    held = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert 0.6 * for_ticks < held < for_ticks + 2_000_000
