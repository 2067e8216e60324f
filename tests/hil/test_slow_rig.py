"""A rig that is polled once in 30 s: what makes it safe does not wait for the next tick."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from drivers.rig.connection import RigConnection
from drivers.rig_file.reader import load_rig
from hil.journal.writer import Header, JournalReader, JournalWriter
from hil.profile.load_profile import Profile
from hil.run.engine import control_socket
from hil.run.engine.clock import MonotonicClock
from hil.run.engine.engine import Engine
from hil.run.engine.operator import RefusedError, Verb
from hil.run.engine.status import Outcome
from tests.hil.guarded_device import HEATER, Device

SOON_S = 3.0
"""A tenth of the period."""


@dataclass
class Slow:
    """A run on a slow rig."""

    device: Device
    engine: Engine
    task: asyncio.Task[Outcome]
    journal: JournalWriter

    async def heats(self) -> None:
        """Wait until the first tick has heated."""
        while self.device.registers[HEATER] != 300:
            await asyncio.sleep(0.02)
        await asyncio.sleep(0.2)

    async def until(self, state: str, within_s: float = SOON_S) -> None:
        end = time.monotonic() + within_s
        while self.engine.state != state:
            assert time.monotonic() < end, self.engine.state
            await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def slow(tmp_path: Path, *, heartbeat: bool = False) -> AsyncIterator[Slow]:
    device = Device()
    text = device.rig_text().replace("period_s = 0.1", "period_s = 30")
    if heartbeat:
        text += (
            '\n[[point]]\nname = "beat"\nbus = "plc"\ntable = "holding"\naddress = 2\nunit = "1"\naccess = "w"\n'
            'kind = "status"\n[heartbeat]\npoint = "beat"\n'
        )
    (tmp_path / "rig.toml").write_text(text)
    rig = load_rig(tmp_path / "rig.toml")
    clock = MonotonicClock(rig.period_s)
    clock._origin -= 29.0  # the first tick comes in a second
    connection = RigConnection(rig, clock.now)
    profile = Profile("slow", np.array([0.0, 900.0]), ("heater_W",), np.array([[300.0], [300.0]]))
    signals = connection.signals + tuple(point.as_signal() for point in rig.setpoints)
    journal = JournalWriter(tmp_path / "journal.sqlite", Header(signals, {}, (), "slow", 900.0, 30.0, {}))
    engine = Engine(connection, clock, profile, journal)
    task = asyncio.create_task(engine.run())
    try:
        yield Slow(device, engine, task, journal)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        with contextlib.suppress(Exception):
            journal.close()
        device.close()


async def test_a_stop_does_not_wait_for_the_next_tick_and_looks_at_the_meter_sooner_than_that(tmp_path):
    async with slow(tmp_path) as run:
        await run.heats()
        run.engine.request_stop("the test")
        outcome = await asyncio.wait_for(run.task, SOON_S)
        assert (outcome.status, outcome.safe, run.device.registers[HEATER]) == ("aborted", True, 0)


async def test_a_pause_does_not_wait_for_the_next_tick_and_is_answered_when_it_is_read_back(tmp_path):
    async with slow(tmp_path) as run:
        await run.heats()
        hold = asyncio.ensure_future(run.engine.ask(Verb.HOLD, "first"))
        await asyncio.sleep(0)
        said = await asyncio.wait_for(run.engine.ask(Verb.PAUSE, "the test"), SOON_S)
        assert said.startswith("paused") and "safe values read back" in said and "heater reads 0.0 W" in said
        assert (run.engine.state, run.device.registers[HEATER]) == ("paused", 0)
        assert hold.done()
        assert (await asyncio.wait_for(run.engine.ask(Verb.PAUSE, "again"), SOON_S)).startswith("paused")
        resume = asyncio.ensure_future(run.engine.ask(Verb.RESUME, "waits for the tick"))
        await asyncio.sleep(0.5)
        assert not resume.done()
        resume.cancel()


async def test_a_pause_that_the_device_does_not_obey_is_not_answered_as_safe(tmp_path):
    async with slow(tmp_path) as run:
        await run.heats()
        run.device.obeys = False
        with pytest.raises(RefusedError, match="NOT confirmed safe"):
            await asyncio.wait_for(run.engine.ask(Verb.PAUSE, "the test"), SOON_S)
        run.device.obeys = True  # else the end tries for its 30 s


async def test_a_request_that_waits_for_the_tick_is_answered_before_its_client_gives_up(tmp_path, monkeypatch):
    assert control_socket.LATE_S < control_socket.ANSWER_WITHIN_S
    monkeypatch.setattr(control_socket, "LATE_S", 0.2)
    async with slow(tmp_path) as run:
        await run.heats()
        async with control_socket.serving(tmp_path / "control.sock", run.engine, lambda text: None):
            answer = await asyncio.to_thread(control_socket.ask, tmp_path / "control.sock", "hold")
        assert answer["ok"] and "on the next tick of this slow rig" in answer["text"]


async def test_an_abort_while_the_rig_is_armed_does_not_wait_for_the_next_tick(tmp_path):
    async with slow(tmp_path, heartbeat=True) as run:
        await run.until("restoring")
        said = await asyncio.wait_for(run.engine.ask(Verb.ABORT, "the test"), SOON_S)
        assert "safe values read back" in said
        assert (await asyncio.wait_for(run.task, SOON_S)).status == "aborted"


@pytest.mark.parametrize("how", ["deleted", "replaced"])
async def test_a_journal_that_is_lost_ends_the_run_before_the_next_tick(tmp_path, how):
    async with slow(tmp_path) as run:
        await run.heats()
        if how == "deleted":
            (tmp_path / "journal.sqlite").unlink()
        else:
            (tmp_path / "other").write_bytes(b"something else")
            (tmp_path / "other").replace(tmp_path / "journal.sqlite")
        outcome = await asyncio.wait_for(run.task, SOON_S)
        assert (outcome.status, outcome.safe, run.device.registers[HEATER]) == ("faulted", True, 0)
        assert "journal.sqlite" in outcome.reason


async def test_every_row_of_a_run_that_was_paused_between_ticks_is_of_its_own_tick(tmp_path):
    async with slow(tmp_path) as run:
        await run.heats()
        await run.engine.ask(Verb.PAUSE, "the test")
        run.engine.request_stop("enough")
        await asyncio.wait_for(run.task, SOON_S)
        run.journal.commit()
        reader = JournalReader(tmp_path / "journal.sqlite")
        ticks = reader.samples().tick.tolist()
        reader.close()
        assert ticks == sorted(set(ticks))
