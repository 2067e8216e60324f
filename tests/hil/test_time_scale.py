"""A rig whose clock is faster than real time, and whose rig file says so."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.rig_file.reader import RigFileError, load_rig
from drivers.virtual.rig import start_virtual_rig
from hil.journal.writer import JournalReader
from hil.rig.check import checked_rig
from hil.run.restore.resumption import Resumption, RunPosition
from hil.run.restore.thermal_restore import RestoreRule
from hil.run.session.request import RunRequest
from hil.run.session.rig_time import speed_of
from hil.run_folder.folder import RunFolder

PROJECT = Path(__file__).resolve().parents[2]
SHIPPED = PROJECT / "profiles" / "rigs" / "virtual.toml"
SPEED = 10.0


def rig_file(place: Path, time_scale: float, modbus: int = 5020, can: int = 29536) -> Path:
    text = SHIPPED.read_text(encoding="utf-8")
    for old, new in (
        ("port = 5020", f"port = {modbus}"),
        ("port = 29536", f"port = {can}"),
        ("period_s = 1.0", f"period_s = 1.0\ntime_scale = {time_scale}"),
        ('twin = "../twins/virtual.toml"', ""),
        ('"thermocouples.dbc"', json.dumps(str(SHIPPED.parent / "thermocouples.dbc"))),
    ):
        assert old in text
        text = text.replace(old, new)
    file = place / "fast.toml"
    file.write_text(text, encoding="utf-8")
    return file


async def hil(*arguments: object) -> tuple[int, str, str]:
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "hil",
        *map(str, arguments),
        cwd=PROJECT,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    out, err = await asyncio.wait_for(process.communicate(), 120)
    assert process.returncode is not None
    return process.returncode, out.decode(), err.decode()


async def test_record_of_a_fast_rig_agrees_with_its_own_uptime(tmp_path):
    load = tmp_path / "load.csv"
    load.write_text("time_s,heater_power_W,pump_speed_pct,fan_speed_pct\n0,300,100,70\n50,300,100,70\n")
    virtual = await start_virtual_rig(mode="scaled", speed=SPEED)
    try:
        rig = rig_file(tmp_path, SPEED, virtual.modbus_port, virtual.can_port)
        began = time.monotonic()
        code, out, err = await hil(
            "run", load, "--rig", rig, "--no-twin", "--runs", tmp_path / "runs", "--no-viewer", "--no-report", "--json"
        )
        took_s = time.monotonic() - began
    finally:
        await virtual.stop()
    assert code == 0, out + err
    reader = JournalReader(RunFolder(Path(json.loads(out)["folder"])).journal)
    samples, names = reader.samples(), [signal.name for signal in reader.header.signals]
    reader.close()
    ahead = samples.values[:, names.index("plc_uptime")] - samples.time_s
    assert samples.time_s[-1] >= 50.0
    assert took_s < 60.0
    # The rig's cycle and the tick are not in step, so that a reading is up to a period old; a busy machine delays some.
    assert (np.abs(ahead - np.median(ahead)) <= 1.0).mean() > 0.9
    assert abs(np.median(ahead[-20:]) - np.median(ahead[:20])) <= 1.0


@pytest.mark.parametrize(
    ("virtual", "control", "mode", "speed"),
    [
        (False, None, "real", 10.0),
        (True, None, "real", 1.0),
        (True, None, "scaled", 4.0),
        (False, ("127.0.0.1", 1), "lockstep", 1.0),
    ],
)
def test_declared_scale_is_of_the_real_rig_alone(tmp_path, virtual, control, mode, speed):
    file = rig_file(tmp_path, SPEED)
    request = RunRequest(
        tmp_path / "load.csv", file, None, tmp_path, virtual=virtual, control=control, mode=mode, speed=4.0
    )
    assert speed_of(request, load_rig(file)) == speed


def test_gap_of_a_fast_rig_is_as_long_as_on_its_clock():
    was = RunPosition(100, 100.0, time.time() - 6.0, 100.0, "running", 2, 100, {})
    assert Resumption(was, RestoreRule(), "cut", SPEED).first_tick(1.0) == pytest.approx(161, abs=3)


async def test_check_tells_how_fast_the_clock_is(tmp_path):
    code, out, err = await hil("check", rig_file(tmp_path, SPEED))
    assert code == 0, out + err
    assert "runs 10 times real time" in out


@pytest.mark.parametrize("scale", [0.0, -1.0, 101.0])
def test_scale_that_no_clock_has_is_refused(tmp_path, scale):
    with pytest.raises(RigFileError, match="time_scale"):
        load_rig(rig_file(tmp_path, scale))


def test_serial_line_is_as_slow_as_it_is_in_real_time(tmp_path):
    text = rig_file(tmp_path, 1.0).read_text(encoding="utf-8")
    text = text.replace('transport = "modbus_tcp"', 'transport = "modbus_rtu_tcp"\nserial_baud = 9600')
    (tmp_path / "slow.toml").write_text(text, encoding="utf-8")
    checked_rig(tmp_path / "slow.toml")
    (tmp_path / "fast.toml").write_text(text.replace("time_scale = 1.0", "time_scale = 100"), encoding="utf-8")
    with pytest.raises(RigFileError, match=r"9600 bit/s and the period is 0\.01 s"):
        checked_rig(tmp_path / "fast.toml")
