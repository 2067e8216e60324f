"""The thermocouple module's frames and the socketcand hub, against python-can and cantools."""

import asyncio
import struct
import time
from collections.abc import AsyncIterator
from pathlib import Path

import can
import cantools.database
import numpy as np
import pytest
import pytest_asyncio

from drivers.virtual.devices import socketcand
from drivers.virtual.devices.socketcand import CanConnection, CanHub, frame_text
from drivers.virtual.devices.supervision import port_of
from drivers.virtual.plant.thermocouple_module import FRAME_IDS, ThermocoupleModule

DBC = Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "thermocouples.dbc"


def test_frames_decode_to_what_was_measured() -> None:
    database = cantools.database.load_file(DBC)
    module = ThermocoupleModule(3)
    junctions = [41.0, 40.5, 40.4, 40.3, 40.2, 40.1, 40.0, 36.5, -5.25]
    decoded: dict[str, float] = {}
    for identifier, data in zip(FRAME_IDS, module.sample(123.0, list(junctions)), strict=True):
        decoded |= database.decode_message(identifier, data)
    names = ["T_heater", *(f"T_pm{k}" for k in range(1, 7)), "T_radiator", "T_tank"]
    assert [decoded[name] for name in names] == pytest.approx(junctions, abs=0.3)
    assert (decoded["tc_uptime"], decoded["tc_fault_bits"]) == (123.0, 0)
    assert {message.frame_id: message.cycle_time for message in database.messages} == dict.fromkeys(FRAME_IDS, 1000)
    for name in names:
        signal = next(s for message in database.messages for s in message.signals if s.name == name)
        assert (signal.minimum, signal.maximum, signal.unit) == (-40, 150, "degC")


def test_noise_offset_and_resolution_are_as_stated() -> None:
    module = ThermocoupleModule(8)
    raw = np.array([struct.unpack("<9h", b"".join(module.sample(t, [30.0] * 9))[:18]) for t in range(6000)])
    errors = raw * 0.01 - 30.0
    assert errors.std(axis=0) == pytest.approx(0.05, rel=0.06)
    assert errors.mean(axis=0) == pytest.approx(module.offsets_K, abs=0.003)
    assert np.abs(module.offsets_K).max() <= 0.03
    assert np.abs(np.corrcoef(errors[1:, 0], errors[:-1, 0])[0, 1]) < 0.05
    same = ThermocoupleModule(8)
    assert [same.sample(t, [30.0] * 9)[2][:2] for t in range(9)] == [struct.pack("<h", v) for v in raw[:9, 8]]


def test_out_of_range_temperatures_saturate_below_the_open_circuit_code() -> None:
    _, _, c = ThermocoupleModule(0).sample(1.0, [30.0] * 8 + [400.0])
    assert struct.unpack("<hH", c[:4]) == (0x7FFE, 0)


class Hub:
    """A hub on a port of its own."""

    def __init__(self, hub: CanHub, port: int) -> None:
        self.hub, self.port = hub, port

    async def open(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        assert await reader.readexactly(6) == b"< hi >"
        for command in (b"< open vcan0 >", b"< rawmode >"):
            writer.write(command)
            assert await reader.readexactly(6) == b"< ok >"
        return reader, writer


@pytest_asyncio.fixture
async def hub(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Hub]:
    monkeypatch.setattr(socketcand, "SETTLE_S", 0.01)
    hub = CanHub(lambda: 12.5)
    server = await asyncio.get_running_loop().create_server(lambda: CanConnection(hub), "127.0.0.1", 0)
    yield Hub(hub, port_of(server))
    server.close()
    for client in tuple(hub.clients):
        client.close()
    await asyncio.sleep(0.01)


async def close(*writers: asyncio.StreamWriter) -> None:
    for writer in writers:
        writer.close()
        await writer.wait_closed()


async def test_a_clients_frames_reach_the_others_and_not_itself(hub: Hub) -> None:
    reader_a, writer_a = await hub.open()
    reader_b, writer_b = await hub.open()
    # Two commands, cut across segments.
    writer_a.write(b"< send 123 2 a ff >< send 1ABCD")
    await writer_a.drain()
    await asyncio.sleep(0.02)
    writer_a.write(b"EF0 0 >")
    first = await reader_b.readuntil(b">")
    second = await reader_b.readuntil(b">")
    assert first == b"< frame 123 12.500000 0AFF >"
    assert second == b"< frame 1ABCDEF0 12.500000  >"
    hub.hub.publish(frame_text("181", 1.0, bytes(8)), 1)
    assert (await reader_a.readuntil(b">")).startswith(b"< frame 181")
    await close(writer_a, writer_b)


@pytest.mark.parametrize(
    "command",
    [b"< open can7 >", b"< rawmode > ", b"< send 123 1 0 >", b"< what >", b"send >", b"x" * 300],
)
async def test_wrong_commands_get_an_error_and_no_frames(hub: Hub, command: bytes) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", hub.port)
    await reader.readexactly(6)
    writer.write(command)
    assert (await reader.readuntil(b">")).startswith(b"< error")
    assert hub.hub.listeners == ()
    await close(writer)


@pytest.mark.parametrize("send", [b"123 2 1", b"123 9 1 2 3 4 5 6 7 8 9", b"12 1 1", b"FFF 1 1", b"123 1 100", b"123"])
async def test_wrong_frames_are_refused(hub: Hub, send: bytes) -> None:
    reader, writer = await hub.open()
    other, other_writer = await hub.open()
    writer.write(b"< send " + send + b" >")
    assert (await reader.readuntil(b">")).startswith(b"< error")
    writer.write(b"< send 7FF 0 >")
    assert (await other.readuntil(b">")).startswith(b"< frame 7FF")
    await close(writer, other_writer)


async def test_a_client_that_does_not_read_stalls_nobody(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socketcand, "LARGEST_BACKLOG", 10_000)
    _, lazy = await hub.open()
    reader, writer = await hub.open()
    await asyncio.sleep(0.02)
    text = frame_text("181", 1.0, bytes(8))
    start = time.perf_counter()
    for _ in range(400):
        for _ in range(500):
            hub.hub.publish(text, 1)
        await asyncio.wait_for(reader.readexactly(500 * len(text)), 5.0)
    assert time.perf_counter() - start < 20.0
    assert hub.hub.dropped > 0
    await close(lazy, writer)


async def test_python_can_hears_and_speaks(hub: Hub) -> None:
    def stranger() -> tuple[can.Message, can.Message]:
        with (
            can.Bus(interface="socketcand", host="127.0.0.1", port=hub.port, channel="vcan0") as one,
            can.Bus(interface="socketcand", host="127.0.0.1", port=hub.port, channel="vcan0") as two,
        ):
            one.send(can.Message(arbitration_id=0x321, data=[1, 2, 3], is_extended_id=False))
            heard = two.recv(5.0)
            two.send(can.Message(arbitration_id=0x1ABCDE, data=bytes(8), is_extended_id=True))
            extended = one.recv(5.0)
            assert heard is not None
            assert extended is not None
            return heard, extended

    heard, extended = await asyncio.to_thread(stranger)
    assert (heard.arbitration_id, bytes(heard.data), heard.is_extended_id) == (0x321, b"\1\2\3", False)
    assert (extended.arbitration_id, extended.is_extended_id) == (0x1ABCDE, True)
