"""Lockstep on a busy machine: a reply that comes late is waited for, and changes no value."""

from __future__ import annotations

import asyncio
import os
import signal
from pathlib import Path

from drivers.rig.connection import RigConnection
from drivers.rig_file.reader import load_rig
from hil.run.session import rig_time
from hil.run.session.request import RunRequest
from hil.run.session.rig_time import rig_and_clock

RIG = Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "virtual.toml"


async def test_a_virtual_rig_that_stands_still_for_longer_than_the_time_out_loses_no_value(monkeypatch):
    from drivers.virtual import rig as virtual

    started = []
    real = virtual.start_virtual_rig

    async def noted(**options):
        started.append(await real(**options))
        return started[-1]

    monkeypatch.setattr(virtual, "start_virtual_rig", noted)
    rig = load_rig(RIG)
    request = RunRequest(profile=Path("load.csv"), rig=RIG, twin=None, runs=Path("runs"), virtual=True, mode="lockstep")
    async with rig_and_clock(request, rig, 0.0, lambda text: None) as (here, clock):
        connection = RigConnection(here, clock.now)
        await connection.connect()
        for _ in range(3):
            await clock.next_tick()
        await connection.wait_for_device_time(clock.now(), 10.0)
        await connection.first_complete(10.0)
        pid = started[0].pids["plc"]
        os.kill(pid, signal.SIGSTOP)
        asyncio.get_running_loop().call_later(2.5, os.kill, pid, signal.SIGCONT)
        snapshot = await connection.read()
        await connection.close()
    assert snapshot.faults == []
    assert max(bus.timeout_s for bus in rig.bus.values()) < 2.5 < rig_time.LOCKSTEP_DEADLINE_S
