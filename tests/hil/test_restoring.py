"""Calibrators that are shown a journal again: what is in it already is not written twice."""

from __future__ import annotations

import contextlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hil.run.session.run
from hil.journal.writer import Header, JournalError, JournalReader, JournalWriter
from hil.run.restore.calibrators import NewResults
from tests.hil.synthetic_journal import make


def test_only_what_the_journal_lacks_is_passed_on(tmp_path):
    header = make(10).header
    proposed: dict[str, Any] = {"values": {}, "standard_errors": {}, "held": {}, "reasons": []}
    band: dict[str, Any] = {"mean_K": {}, "half_width_K": {}}
    journal = JournalWriter(tmp_path / "journal.sqlite", header)
    journal.twin_outputs("static", [0, 1, 2], [0.0, 1.0, 2.0], np.zeros((3, 4)))
    journal.calibration("pso", 0.0, 600.0, {"kind": "calibrated"})
    journal.proposal("hiera_unet", 300.0, proposed)
    journal.band("static", 0.0, 600.0, band)
    journal.commit()
    reader = JournalReader(tmp_path / "journal.sqlite")
    rest = NewResults(journal, reader)
    rest.twin_outputs("static", [1, 2, 3, 4], [1.0, 2.0, 3.0, 4.0], np.arange(16.0).reshape(4, 4))
    rest.twin_outputs("pso", [0, 1], [0.0, 1.0], np.ones((2, 4)))
    for end_s in (600.0, 1200.0):
        rest.calibration("pso", end_s - 600.0, end_s, {"kind": "calibrated"})
        rest.event(7, end_s, "WARN", f"of the window up to {end_s:g}")
        rest.proposal("hiera_unet", end_s / 2, proposed)
        rest.event(7, end_s, "INFO", f"of the proposal at {end_s / 2:g}")
        rest.band("static", end_s - 600.0, end_s, band)
    rest.event(7, 0.0, "ERROR", "pso: stopped")
    journal.commit()
    assert reader.twin_outputs("static").tick.tolist() == [0, 1, 2, 3, 4]
    assert reader.twin_outputs("static").values[3:].tolist() == np.arange(8.0, 16.0).reshape(2, 4).tolist()
    assert reader.twin_outputs("pso").tick.tolist() == [0, 1]
    assert [row.end_s for row in reader.calibrations()] == [600.0, 1200.0]
    assert [row.time_s for row in reader.proposals()] == [300.0, 600.0]
    assert [row.end_s for row in reader.bands()] == [600.0, 1200.0]
    assert [row.text for row in reader.events()] == [
        "of the window up to 1200",
        "of the proposal at 600",
        "pso: stopped",
    ]
    reader.close()
    journal.close()


def test_a_journal_of_other_signals_is_not_written_on(tmp_path):
    truth = make(10)
    path = tmp_path / "journal.sqlite"
    with pytest.raises(JournalError, match="does not exist"):
        JournalWriter(path, truth.header, again=True)
    JournalWriter(path, truth.header).close()
    other = Header(truth.header.signals[1:], {}, (), "load", 1.0, 1.0, {})
    with pytest.raises(JournalError, match="is of other signals or twins"):
        JournalWriter(path, other, again=True)
    JournalWriter(path, truth.header, again=True).close()
    assert [file.name for file in tmp_path.iterdir()] == ["journal.sqlite"]
    JournalReader(path).close()
    assert [file.name for file in tmp_path.iterdir()] == ["journal.sqlite"]


async def test_calibrators_that_do_not_come_back_start_anew_and_that_is_said(monkeypatch):
    said: list[str] = []
    noted: list[tuple[Any, ...]] = []
    fresh = SimpleNamespace(close=None)

    async def fails(tracking: Any, journal: Any, path: Path, say: Any) -> None:
        tracking.failures.append("pso stopped: the process ended")

    async def start(request: Any, ready: Any) -> Any:
        return fresh

    async def close() -> None:
        pass

    fresh.close = close
    monkeypatch.setattr(hil.run.session.run, "restore_calibrators", fails)
    monkeypatch.setattr(hil.run.session.run, "start_tracking", start)
    run: Any = SimpleNamespace(
        resumption=SimpleNamespace(position=SimpleNamespace(tick=7, time_s=7.0)),
        folder=SimpleNamespace(journal=None),
        announce=said.append,
        request=None,
        ready=None,
    )
    tracking: Any = SimpleNamespace(failures=[])
    journal: Any = SimpleNamespace(event=lambda *row: noted.append(row))
    async with contextlib.AsyncExitStack() as stack:
        assert await hil.run.session.run._restored(stack, run, tracking, journal) is fresh
    sentence = "the calibrators could not be restored and start anew: pso stopped: the process ended"
    assert said[-1] == sentence
    assert noted == [(7, 7.0, "WARN", sentence)]
