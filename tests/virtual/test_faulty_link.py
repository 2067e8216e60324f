"""The wire that fails on request, and the rig's truth and reboot, by strangers on raw sockets."""

from __future__ import annotations

import asyncio
import random
import struct
from pathlib import Path

import pytest

from drivers.virtual.devices.truth import last_moment, read_truth
from drivers.virtual.faults import faulty_replies as replies
from drivers.virtual.faults.faulty_link import FaultyLink, can_frames, modbus_frames
from drivers.virtual.rig import start_virtual_rig

READ = struct.pack(">HHHBBHH", 7, 0, 6, 1, 4, 0, 12)
REPLY = struct.pack(">HHHBBB", 7, 0, 27, 1, 4, 24) + bytes(range(24))


class Device:
    """Answers every request with `REPLY`."""

    def __init__(self) -> None:
        self.heard = b""
        self.port = 0

    async def __aenter__(self) -> Device:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(100):
                self.heard += data
                writer.write(REPLY)
        except ConnectionError:
            pass
        writer.close()


async def asked(link: FaultyLink, seconds: float = 0.3) -> bytes:
    """What comes back to one request on a connection of its own."""
    reader, writer = await asyncio.open_connection("127.0.0.1", link.port)
    writer.write(READ)
    said = b""
    try:
        async with asyncio.timeout(seconds):
            while data := await reader.read(100):
                said += data
                if len(said) >= len(REPLY):
                    break
    except TimeoutError:
        pass
    writer.close()
    return said


async def test_a_wire_in_good_order_changes_nothing():
    async with Device() as device, FaultyLink(device.port, modbus_frames) as link:
        assert await asked(link) == REPLY
        link.change = replies.split_up(random.Random(1), 1.0)
        assert await asked(link) == REPLY


async def test_a_dropped_wire_resets_and_refuses_until_it_is_restored():
    async with Device() as device, FaultyLink(device.port, modbus_frames) as link:
        reader, writer = await asyncio.open_connection("127.0.0.1", link.port)
        writer.write(READ)
        assert await reader.readexactly(len(REPLY)) == REPLY
        link.drop()
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await reader.readexactly(1)
        with pytest.raises(ConnectionError):
            await asyncio.open_connection("127.0.0.1", link.port)
        writer.close()
        await link.restore()
        assert await asked(link) == REPLY


async def test_a_half_open_wire_stays_open_and_says_nothing_either_way():
    async with Device() as device, FaultyLink(device.port, modbus_frames) as link:
        reader, writer = await asyncio.open_connection("127.0.0.1", link.port)
        writer.write(READ)
        await reader.readexactly(len(REPLY))
        link.mute()
        heard = device.heard
        writer.write(READ)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.2):
                await reader.read(1)
        assert device.heard == heard
        assert await asked(link, 0.2) == b""
        writer.close()


@pytest.mark.parametrize(
    "change", [replies.garbled_header, replies.cut_off, replies.too_few_registers, replies.wrong_function]
)
async def test_each_fault_changes_the_reply_and_the_same_seed_does_the_same(change):
    async with Device() as device, FaultyLink(device.port, modbus_frames) as link:
        link.change = change(random.Random(3), 1.0)
        first = await asked(link)
        link.change = change(random.Random(3), 1.0)
        assert await asked(link) == first != REPLY
        assert link.changed == 2


def test_changes_say_what_they_do():
    def one(change: object, frame: bytes = REPLY) -> bytes:
        return b"".join(piece for _, piece in change(frame))  # type: ignore[operator]

    for seed in range(50):
        generator = random.Random(seed)
        garbled = one(replies.garbled_header(generator, 1.0))
        assert garbled[9:] == REPLY[9:] and garbled != REPLY
        assert REPLY.startswith(one(replies.cut_off(generator, 1.0)))
        short = one(replies.too_few_registers(generator, 1.0))
        assert struct.unpack(">H", short[4:6])[0] == len(short) - 6
        assert short[8] == len(short) - 9 < 24
        ((delay, whole),) = replies.late(generator, 1.0, 0.4, 2.0)(REPLY)
        assert 0.4 <= delay <= 2.0 and whole == REPLY
        line = b"< frame 181 12.000000 0011223344556677 >"
        assert len(one(replies.without_a_digit(generator, 1.0), line)) < len(line)
    assert one(replies.wrong_function(random.Random(1), 1.0))[7] == 3
    assert replies.garbled_header(random.Random(1), 0.0)(REPLY) == [(0.0, REPLY)]


def test_streams_are_cut_into_frames_wherever_the_segments_end():
    stream = REPLY * 3
    for cut in range(len(stream)):
        first, rest = modbus_frames(stream[:cut])
        second, rest = modbus_frames(rest + stream[cut:])
        assert first + second == [REPLY] * 3 and rest == b""
    assert can_frames(b"< hi >< frame 1 ") == ([b"< hi >"], b"< frame 1 ")


def _request(function: int, address: int, value: int) -> bytes:
    return struct.pack(">HHHBBHH", 1, 0, 6, 1, function, address, value)


async def test_the_rig_keeps_its_own_truth_and_a_reboot_forgets_everything(tmp_path: Path):
    path = tmp_path / "truth.bin"
    async with await start_virtual_rig(period_s=0.1, truth=path) as rig:
        reader, writer = await asyncio.open_connection(rig.host, rig.modbus_port)
        for address, value in ((0, 4000), (1, 1000), (3, 1), (5, 1)):
            writer.write(_request(6, address, value))
            await reader.readexactly(12)
        await asyncio.sleep(0.5)
        assert read_truth(path)[-1].heater_W == 400.0
        assert read_truth(path)[-1].power_W > 20.0
        control, commands = await asyncio.open_connection(rig.host, rig.control_port)
        await control.readline()
        for line, answer in ((b"reboot soon\n", b"error"), (b"reboot 1e9\n", b"error"), (b"reboot 0.4\n", b"ok")):
            commands.write(line)
            assert (await control.readline()).startswith(answer)
        assert read_truth(path)[-1].heater_W == 0.0
        assert await reader.read() == b""
        with pytest.raises(ConnectionError):
            await asyncio.open_connection(rig.host, rig.modbus_port)
        await asyncio.sleep(0.7)
        reader, writer2 = await asyncio.open_connection(rig.host, rig.modbus_port)
        writer2.write(_request(3, 0, 6))
        assert struct.unpack(">6H", (await reader.readexactly(21))[9:]) == (0, 0, 0, 0, 100, 0)
        writer2.write(_request(4, 8, 2))
        uptime_s = struct.unpack(">I", (await reader.readexactly(13))[9:])[0] / 1000.0
        assert 0.3 < uptime_s < 2.0
        for each in (writer, writer2, commands):
            each.close()
    moments = read_truth(path)
    assert last_moment(path) == moments[-1]
    assert len(moments) > 10
    assert all(a.wall_s <= b.wall_s and a.rig_s <= b.rig_s for a, b in zip(moments, moments[1:], strict=False))
    with path.open("ab") as file:
        file.write(bytes(100))  # the beginning of a record that is being written
    assert last_moment(path) == moments[-1]
    path.write_bytes(b"")
    assert last_moment(path) is None


async def test_a_reply_that_pymodbus_cannot_decode_is_a_lost_link_and_no_traceback(caplog):
    import time

    from drivers.modbus.bus import ModbusBus
    from drivers.rig_file.bus_sections import ModbusTcpBus
    from drivers.rig_file.model import Point
    from drivers.signals.points import Quality

    point = Point(name="x", bus="b", unit="1", table="input", address=0)
    generator = random.Random(5)

    async with await start_virtual_rig(period_s=0.1) as rig, FaultyLink(rig.modbus_port, modbus_frames) as link:
        bus = ModbusBus(
            "b", ModbusTcpBus(transport="modbus_tcp", port=link.port, timeout_s=0.1), (point,), time.monotonic
        )
        await bus.connect()
        bad = 0
        for _ in range(30):
            link.change = replies.garbled_header(generator, 1.0)
            readings = await bus.read()
            bad += readings.quality != [Quality.GOOD]
            if readings.quality == [Quality.GOOD]:
                assert readings.values == [0.0]
            link.change = None
            await asyncio.sleep(0.01)
            bus.link.drop()
            await bus.link.open("b")
        await bus.close()
    assert bad >= 25
    assert not [record for record in caplog.records if record.name == "asyncio"]
