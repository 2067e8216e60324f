"""A reader of a rig that is stopped by a signal: nothing that lay in a queue meanwhile is good afterwards."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import time
from pathlib import Path

import pytest

from drivers.rig_file.reader import load_rig
from drivers.signals.points import Quality
from drivers.virtual.devices.truth import Moment, read_truth
from drivers.virtual.plant.geometry import CHANNELS
from drivers.virtual.rig import start_virtual_rig

PROJECT = Path(__file__).resolve().parents[2]
RIG = PROJECT / "profiles" / "rigs" / "virtual.toml"
STALE_AFTER_S = 1.0
STOPPED_S = 2.5
STOPS = 3
PERIOD_S = 0.02
"""Of the rig: many frames come in a gap, so that the reader looks while they are taken out of the queue."""
READER = """
import asyncio, json, sys, time
from pathlib import Path
from drivers.rig.connection import RigConnection
from drivers.rig_file.reader import load_rig
from drivers.bus.steady_time import steady_s

async def main():
    rig = load_rig(Path(sys.argv[1])).with_ports({"plc": int(sys.argv[2]), "thermocouples": int(sys.argv[3])})
    points = tuple(p.model_copy(update={"stale_after_s": float(sys.argv[4])}) for p in rig.point)
    connection = RigConnection(rig.model_copy(update={"point": points}), steady_s)
    await connection.connect()
    names = [point.name for point in connection.points]
    while True:
        began = time.time()
        snapshot = await connection.read()
        row = {n: v for n, v, q in zip(names, snapshot.values, snapshot.quality) if q == 0}
        print(json.dumps({"began": began, "wall": time.time(), "good": row}), flush=True)
        await asyncio.sleep(0.001)

asyncio.run(main())
"""


async def test_what_was_queued_while_the_reader_was_stopped_is_not_good(tmp_path):
    truth = tmp_path / "truth.bin"
    rig = await start_virtual_rig(seed=1, mode="real", period_s=PERIOD_S, effects=None, truth=truth)
    async with rig:
        with (tmp_path / "rows").open("wb") as output:
            reader = await asyncio.create_subprocess_exec(
                sys.executable,
                "-c",
                READER,
                str(RIG),
                str(rig.modbus_port),
                str(rig.can_port),
                str(STALE_AFTER_S),
                stdout=output,
                env={**os.environ, "PYTHONPATH": str(PROJECT)},
            )
        try:
            while len(rows(tmp_path)) < 40:
                assert reader.returncode is None
                await asyncio.sleep(0.1)
            for _ in range(STOPS):
                reader.send_signal(signal.SIGSTOP)
                await asyncio.sleep(STOPPED_S)
                resumed = time.time()
                reader.send_signal(signal.SIGCONT)
                await asyncio.sleep(1.5)
        finally:
            reader.send_signal(signal.SIGCONT)
            reader.kill()
            await reader.wait()
    found, moments = rows(tmp_path), read_truth(truth)
    after = [row for row in found if row["wall"] > resumed]
    assert len(after) > 20, "the reader went on"
    assert any(len(row["good"]) == len(POLLED) for row in after), "all is good again"
    assert [said for row in found for said in older(row, moments)] == []


POLLED = [point for point in load_rig(RIG).point if point.is_polled]


def rows(folder: Path) -> list[dict]:
    text = (folder / "rows").read_text(encoding="utf-8")
    return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]


def older(row: dict, moments: list[Moment]) -> list[str]:
    """Good values that were true at no time within the staleness limit: the module's own clock, and temperatures."""
    slack_s = 2 * PERIOD_S + 0.3  # of the rig's period, and of what an unseen stall may hide
    window = [m for m in moments if row["began"] - STALE_AFTER_S - slack_s <= m.wall_s <= row["wall"] + PERIOD_S]
    if not window:
        return []
    said = []
    uptime = row["good"].get("tc_uptime")
    if uptime is not None and uptime < window[0].rig_s - PERIOD_S:
        said.append(f"frames of {uptime:.1f} s are good, the oldest that may be is {window[0].rig_s:.1f} s")
    for number, channel in enumerate(CHANNELS):
        value = row["good"].get(channel)
        true = [m.junctions_C[number] for m in window]
        if value is not None and not min(true) - 0.2 <= value <= max(true) + 0.2:
            said.append(f"{channel} {value:.2f} is good, true were {min(true):.2f} to {max(true):.2f}")
    return said


@pytest.mark.parametrize("age_s", [0.5, 3.0])
def test_the_judge_sees_an_old_frame(age_s):
    moments = [Moment(100.0 + k, float(k), 0, 0, 0, 0, 0, 0, 0, (20.0,) * len(CHANNELS)) for k in range(11)]
    row = {"began": 110.0, "wall": 110.0, "good": {"tc_uptime": 10.0 - age_s}}
    assert bool(older(row, moments)) == (age_s > 2.0)
    assert Quality.GOOD == 0
