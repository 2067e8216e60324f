"""Events of a calibration: entries, fan trips and start-ups of the record, steps; in the folder, report and review."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.record import RecordError
from hil.review import write_tower_review
from hil.tower.governance.events_file import event_lines, read_events, write_events
from hil.tower.station import StationNotes, iso
from hil.tower.station.alignment import event_entry
from tests.hil.tower.made_plant import run
from twin.historian.events import Event
from twin.historian.regimes import Regime
from twin.tower.change_detection import Step

START_S, N = 1_700_000_040.0 // 60 * 60, 2880
OFF_UNTIL = {1: 600, 2: 612}


def result(cell: int, *, trips: tuple[tuple[int, int], ...] = (), steps: tuple[Step, ...] = ()) -> Any:
    """Return what the events need of a calibrated cell that starts in the minute `OFF_UNTIL` and has fan faults."""
    minute = np.arange(N)
    regime = np.where(minute < OFF_UNTIL[cell], Regime.OFF, Regime.HIGH_FAN).astype(np.uint8)
    fault = np.zeros(N)
    for first, end in trips:
        fault[first:end] = 1.0
    columns = {"m_w_kg_s": np.where(minute < OFF_UNTIL[cell], 0.0, 400.0), "fan_fault": fault}
    time_s = START_S + 60.0 * minute
    return SimpleNamespace(
        cell=cell,
        record=SimpleNamespace(columns=columns, time_s=time_s),
        minutes=SimpleNamespace(time_s=time_s, regime=regime),
        steps=steps,
        changes=(),
    )


def entry(cell: int, kind: str, minute: int, parameters: tuple[str, ...] = ()) -> dict[str, Any]:
    at = START_S + 60.0 * minute
    what = {"cell": cell, "kind": kind, "source": "DCS", "text": "", "parameters": list(parameters)}
    return what | {"by_day": False, "time": iso(at), "from": iso(at), "to": iso(at + 4 * 3600.0)}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with the events of two cells: an entered and an unentered trip, a cleaning, a step, others'."""
    notes = StationNotes(
        {},
        (
            entry(1, "fan_trip", 1000),
            entry(0, "cleaning", 1500, ("fill", "uniformity")),
            entry(3, "cleaning", 1500, ("fill",)),
            entry(1, "inspection", 99_999),
        ),
    )
    step = Step(START_S + 60.0 * 2000, START_S + 60.0 * 2010, 0.5, True)
    write_events([result(1, trips=((1002, 1060), (1700, 1730))), result(2, steps=(step,))], notes, tmp_path)
    return tmp_path


def test_entries_of_the_cells_stand_beside_what_the_record_shows(folder: Path) -> None:
    found = [(e["cell"], e["kind"], e["source"]) for e in read_events(folder)]
    assert found == [
        (1, "start_up", "record"),
        (2, "start_up", "record"),
        (1, "fan_trip", "DCS"),
        (0, "cleaning", "DCS"),
        (1, "fan_trip", "record"),
        (2, "thermometer_step", "calibration"),
    ]
    start, _, _, _, trip, step = read_events(folder)
    assert start["text"] == "together with cell 2" and start["time"] == iso(START_S + 60.0 * OFF_UNTIL[1])
    assert "30 min" in trip["text"] and step["parameters"] == ["bias"]


def test_a_start_far_from_the_other_cells_is_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OFF_UNTIL, 2, 900)
    write_events([result(1), result(2)], StationNotes(), tmp_path)
    assert [e["text"] for e in read_events(tmp_path)] == ["", ""]


def test_the_report_counts_events_and_lists_those_that_may_move_a_deviation(folder: Path) -> None:
    lines = event_lines(folder)
    assert "| 1 | start up, together with cell 2 | record | 1 |" in lines
    moving = [line for line in lines if line.startswith("- ")]
    assert len(moving) == 2 and "all cells: cleaning (DCS), fill, uniformity" in moving[0]


def test_a_calibration_writes_its_events_and_the_report_has_them(plant: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run("calibrate", plant / "record", "--twin", plant / "cell1.toml", "--out", out)
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert "inspection" in [e["kind"] for e in read_events(out)]
    assert "| 1 | inspection | CMMS | 1 |" in run("report", out).output
    (out / "events.json").unlink()
    assert "events.json is missing; calibrate again" in run("report", out).output


def test_a_damaged_file_is_refused_with_its_place(folder: Path) -> None:
    document = json.loads((folder / "events.json").read_text())
    document["events"][1]["from"] = "noon"
    (folder / "events.json").write_text(json.dumps(document))
    with pytest.raises(RecordError, match=r"events\.json: events\[1\]\.from is 'noon'.*calibrate again"):
        read_events(folder)


def test_the_review_shows_events_of_the_cell_and_the_station(folder: Path, plant: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun is not installed: there is no review")
    from hil.review.rerun_io import read_words

    out = tmp_path / "out"
    done = run("calibrate", plant / "record", "--twin", plant / "cell1.toml", "--out", out)
    assert done.exit_code == 0, done.output
    begin = read_events(out)[0]["from"]
    events = [e | {"from": begin, "to": begin, "time": begin} for e in read_events(folder)]
    write_tower_review(out / "calibrated.parquet", tmp_path / "review.rrd", "out", events=events)
    texts = [word or "" for _, word in read_words(tmp_path / "review.rrd", "/tower/cell1/events/list")]
    assert len(texts) == 4 and texts[0] == "start up (record): together with cell 2"
    states = {word for _, word in read_words(tmp_path / "review.rrd", "/tower/cell1/events/maintenance")}
    assert states == {"cleaning", None}
    assert not read_words(tmp_path / "review.rrd", "/tower/cell1/events/found")


def test_an_entry_by_the_day_may_be_of_the_end_of_the_work() -> None:
    """Cleaning takes up to a day, and the date is up to three days off; a trip has its minute."""
    day = 86400.0
    by_day = event_entry(Event(1000.0 * day, True, 1, "cleaning", "CMMS", "fill washed"))
    assert (by_day["from"], by_day["to"]) == (iso(996.0 * day), iso(1005.0 * day))
    trip = event_entry(Event(1000.0 * day, False, 1, "fan_trip", "DCS"))
    assert (trip["from"], trip["to"]) == (iso(1000.0 * day), iso(1000.0 * day + 4.0 * 3600.0))
