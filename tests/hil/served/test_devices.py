"""Served devices as foreign clients see them: mbpoll on Modbus, python-can with cantools on CAN."""

from __future__ import annotations

import asyncio
import shutil
import struct
import subprocess
import time
from pathlib import Path

import can
import cantools
import pytest

from drivers.rig import RigConnection
from drivers.rig_file.reader import load_rig
from drivers.signals.points import DeviceExceptionError, Quality
from hil.served_rig.served_file import moved_rig, write_served_file
from hil.served_rig.start import ServedRig, ServedRigError, ServedRigOptions, start_served_rig
from tests.hil.served.rig_files import bench_file, loop_file

needs_mbpoll = pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (Debian package)")


def mbpoll(*arguments: str) -> str:
    done = subprocess.run(["mbpoll", "-0", "-1", *arguments], capture_output=True, text=True, timeout=20, check=False)
    return done.stdout + done.stderr


def numbers(text: str) -> list[str]:
    return [line.split("\t")[1].split()[0].strip() for line in text.splitlines() if line.startswith("[")]


async def plc(served: ServedRig, *arguments: str) -> str:
    """Answer of the device 7 on Modbus/TCP."""
    port = served.sections["plc"]["port"]
    return await asyncio.to_thread(mbpoll, "-m", "tcp", "-a", "7", "-p", str(port), *arguments)


@needs_mbpoll
async def test_a_foreign_client_reads_and_writes_the_encodings_of_the_file(tmp_path: Path) -> None:
    async with await start_served_rig(bench_file(tmp_path), ServedRigOptions()) as served:
        raw = int(numbers(await plc(served, "-t", "3:hex", "-r", "20", "-c", "1", "127.0.0.1"))[0], 16)
        swapped = struct.unpack("<h", struct.pack(">H", raw))[0]
        assert 30.0 <= 0.01 * swapped <= 70.0
        assert swapped != 5500
        shared = int(numbers(await plc(served, "-t", "3", "-r", "21", "-c", "1", "127.0.0.1"))[0])
        assert (shared & 1, shared >> 4 & 7) == (0, 3)
        beat, high = "1", struct.unpack(">2H", struct.pack(">f", 750.0))
        assert "Written 1" in await plc(served, "-t", "4", "-r", "12", "127.0.0.1", beat)
        assert "Written 1" in await plc(served, "-t", "0", "-r", "4", "127.0.0.1", "1")
        written = await plc(served, "-t", "4", "-r", "10", "127.0.0.1", str(high[1]), str(high[0]))
        assert "Written 2" in written
        await asyncio.sleep(0.6)
        line = served.sections["meter"]["serial_port"]
        rtu = ("-m", "rtu", "-a", "3", "-b", "19200", "-P", "none")
        said = await asyncio.to_thread(mbpoll, *rtu, "-t", "3:hex", "-r", "100", "-c", "2", line)
        words = [int(text, 16) for text in numbers(said)]
        assert struct.unpack("<i", struct.pack(">2H", *words))[0] == -75000
        text = numbers(await plc(served, "-t", "4:hex", "-r", "40", "-c", "4", "127.0.0.1"))
        assert struct.pack("<4H", *(int(word, 16) for word in text)) == b"SN-4711\0"


@needs_mbpoll
async def test_what_the_file_does_not_have_is_refused(tmp_path: Path) -> None:
    async with await start_served_rig(bench_file(tmp_path), ServedRigOptions()) as served:
        assert "Illegal data address" in await plc(served, "-t", "3", "-r", "19", "-c", "2", "127.0.0.1")
        assert "Illegal data address" in await plc(served, "-t", "3", "-r", "26", "-c", "1", "127.0.0.1")
        assert "Illegal function" in await plc(served, "-t", "1", "-r", "0", "-c", "1", "127.0.0.1")
        assert "Illegal data address" in await plc(served, "-t", "4", "-r", "40", "127.0.0.1", "1")
        port = str(served.sections["plc"]["port"])
        other = await asyncio.to_thread(mbpoll, "-m", "tcp", "-a", "8", "-p", port, "-t", "3", "-r", "20", "127.0.0.1")
        assert "Target device failed to respond" in other


async def test_the_watchdog_cuts_what_no_beat_confirms(tmp_path: Path) -> None:
    file = bench_file(tmp_path)
    async with await start_served_rig(file, ServedRigOptions()) as served:
        rig = moved_rig(load_rig(file), served.sections)
        connection = RigConnection(rig, time.monotonic)
        await connection.connect()
        try:
            await connection.write({"heater_power_set": 500.0, "valve_set": 62.5})
            assert (await values(connection))["heater_power"] == 0.0  # not armed
            await connection.write({"beat": 1.0, "patience": 1.0})
            await connection.write({"enable": 1.0})
            await asyncio.sleep(0.6)
            assert (await values(connection))["heater_power"] == pytest.approx(500.0, abs=0.01)
            await asyncio.sleep(1.2)
            found = await values(connection)
            assert (found["heater_power"], found["state"]) == (0.0, 2.0)
            held = await connection.read_back(("heater_power_set", "valve_set", "enable"))
            assert held == {"heater_power_set": 0.0, "valve_set": 30.0, "enable": 0.0}
            with pytest.raises(DeviceExceptionError):
                await connection.write({"enable": 1.0})
            await connection.write({"beat": 2.0})
            await connection.write({"enable": 1.0})
            await asyncio.sleep(0.6)
            assert (await values(connection))["state"] == 0.0
        finally:
            await connection.close()


async def values(connection: RigConnection) -> dict[str, float]:
    snapshot = await connection.read()
    assert set(snapshot.quality) == {Quality.GOOD}
    return dict(zip((point.name for point in connection.points), snapshot.values, strict=True))


async def test_frames_carry_the_twin_s_temperatures_for_a_foreign_decoder(tmp_path: Path) -> None:
    file = loop_file(tmp_path)
    async with await start_served_rig(file, ServedRigOptions(twin=tmp_path / "twin.toml")) as served:
        where = served.sections["can"]
        assert (where["transport"], where["channel"]) == ("socketcand", "can1")
        heard = await asyncio.to_thread(listen, where["host"], where["port"], 2.5)
        database = cantools.database.load_file(tmp_path / "temps.dbc")
        decoded = [(at, database.decode_message(frame, data)) for at, frame, data in heard]
        rooms = [at for at, signals in decoded if "T_room" in signals]
        assert len(rooms) >= 15  # its cycle time is 0.1 s
        room = next(signals["T_room"] for _, signals in decoded if "T_room" in signals)
        tank = next(signals["T_tank"] for _, signals in decoded if "T_tank" in signals)
        heater = next(signals["T_heater"] for _, signals in decoded if "T_heater" in signals)
        assert room == pytest.approx(22.0, abs=0.1)  # the twin's nominal room, in which it begins at rest
        assert tank == pytest.approx(22.0, abs=0.5)
        assert heater == pytest.approx(22.0, abs=0.5)


def listen(host: str, port: int, seconds: float) -> list[tuple[float, int, bytes]]:
    """Frames that python-can receives: time of arrival, identifier, data."""
    found = []
    with can.Bus(interface="socketcand", host=host, port=port, channel="can1") as bus:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            message = bus.recv(left)
            if message is not None:
                found.append((message.timestamp, message.arbitration_id, bytes(message.data)))
    return found


async def test_a_written_file_points_to_the_devices_from_any_folder(tmp_path: Path) -> None:
    file, out = loop_file(tmp_path), tmp_path / "trial" / "served.toml"
    out.parent.mkdir()
    async with await start_served_rig(file, ServedRigOptions()) as served:
        write_served_file(file, served.sections, out)
        rig, moved = load_rig(out), moved_rig(load_rig(file), served.sections)
        assert rig.point == moved.point
        assert rig.bus == moved.bus
        assert rig.twin is not None
        assert rig.twin.samefile(tmp_path / "twin.toml")
        connection = RigConnection(rig, time.monotonic)
        await connection.connect()
        try:
            snapshot = await connection.first_complete(5.0)
            assert set(snapshot.quality) == {Quality.GOOD}
        finally:
            await connection.close()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"high = 70.0": "high = 20.0"}, r"bench.toml, line \d+: T_tank cannot be served: no value is inside"),
        ({'expect = "SN-4711"': 'expect = "SN-4711-0815"'}, r"serial_number cannot be served: .* takes 12 bytes"),
    ],
)
async def test_a_point_that_cannot_be_served_gives_one_sentence(
    tmp_path: Path, changes: dict[str, str], said: str
) -> None:
    with pytest.raises(ServedRigError, match=said) as caught:
        await start_served_rig(bench_file(tmp_path, **changes), ServedRigOptions())
    assert "\n" not in str(caught.value)


async def test_a_twin_of_another_rig_is_refused(tmp_path: Path) -> None:
    loop_file(tmp_path)
    text = (tmp_path / "twin.toml").read_text()
    (tmp_path / "other.toml").write_text(text.replace("T_tank_C", "T_basin_C").replace("T_heater_C", "T_oven_C"))
    file = bench_file(tmp_path)
    with pytest.raises(ServedRigError, match=r"no sensor of the twin .* is a point of bench"):
        await start_served_rig(file, ServedRigOptions(twin=tmp_path / "other.toml"))
