"""Calibrators whose process stands still: the run that asks them ends all the same, and says what is missing."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import time
from pathlib import Path

import pytest

from hil.tracking import process
from hil.tracking.process import TrackingProcess
from hil.tracking.twins import TrackingConfig
from tests.hil.test_tracking import small_twin


class Heard:
    """A journal that keeps the events."""

    def __init__(self) -> None:
        self.events: list[str] = []

    def event(self, tick: int, time_s: float, level: str, text: str) -> None:
        self.events.append(text)

    def twin_outputs(self, *row: object) -> None:
        pass

    def calibration(self, *row: object) -> None:
        pass

    def proposal(self, *row: object) -> None:
        pass

    def band(self, *row: object) -> None:
        pass


def config_of(folder: Path) -> TrackingConfig:
    path = folder / "small.toml"
    path.write_text(small_twin(600.0, ("heat.factor",)), encoding="utf-8")
    columns = ("heater_power_W", "T_ambient_C", "T_plate_C", "T_radiator_C", "T_tank_C")
    return TrackingConfig(path, columns, ("kalman",))


@pytest.mark.parametrize("wide", [False, True])
async def test_a_stopped_process_is_ended_within_seconds_and_its_results_are_said_to_be_missing(
    tmp_path, monkeypatch, wide
):
    monkeypatch.setattr(process, "IDLE_AT_MOST_S", 1.0)
    tracking, heard = TrackingProcess(config_of(tmp_path), wait=False), Heard()
    await tracking.start()
    tracking.attach(heard)  # type: ignore[arg-type]
    pid = tracking.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    began = time.monotonic()
    # A wide block fills the pipe, and the engine that publishes it must not wait for that.
    row = [100.0, 20.0, 45.0, 38.0, 34.0] + [0.0] * (20_000 if wide else 0)
    for tick in range(6):
        await tracking.publish([tick], [float(tick)], [row])
    assert time.monotonic() - began < 0.5
    assert await tracking.finish() is None
    assert time.monotonic() - began < 6.0
    assert tracking.failure is not None
    assert "did nothing for" in tracking.failure and "missing" in tracking.failure
    assert any("stopped, the run goes on without" in text for text in heard.events)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    await asyncio.sleep(0)


async def test_a_process_that_works_for_longer_than_that_is_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(process, "IDLE_AT_MOST_S", 2.0)
    tracking, heard = TrackingProcess(config_of(tmp_path), wait=True), Heard()
    await tracking.start()
    tracking.attach(heard)  # type: ignore[arg-type]
    for block in range(5):
        ticks = list(range(60 * block, 60 * block + 60))
        rows = [[100.0, 20.0, 45.0, 38.0, 34.0]] * 60
        await tracking.publish(ticks, [10.0 * tick for tick in ticks], rows)
    assert await tracking.finish() is not None
    assert tracking.failure is None
    with contextlib.suppress(Exception):
        await tracking.close()
