"""Devices that answer oddly, and services that are no Modbus: values where these are sure, else the defect by name."""

from __future__ import annotations

import asyncio
import re

import pytest

from drivers.modbus.protocol.pymodbus_codec import rtu_frame
from drivers.rig_file.bus_sections import ModbusRtuTcpBus
from drivers.signals.points import DriverError, Quality
from tests.drivers.odd_device import Serve, answer, driver, every, good, listening, mbap


def says(data: bytes, *, at_once: bool = False) -> Serve:
    """A service that sends `data` when it is connected to, or once something has come."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not at_once:
            await reader.read(1)
        writer.write(data)
        await reader.read()

    return serve


async def refusal(serve: Serve, **changes: object) -> str:
    """Why a device cannot be connected to."""
    async with listening(serve) as port:
        bus = driver(port, **changes)
        with pytest.raises(DriverError) as caught:
            await bus.connect()
        await bus.close()
    return str(caught.value)


STRANGERS: dict[str, tuple[Serve, str]] = {
    "a byte too many announced": (every(lambda t, u, p: mbap(t, u, answer(p), more=1)), "announces 6 bytes and has 5"),
    "the header counted, too": (every(lambda t, u, p: mbap(t, u, answer(p), more=6)), "announces 11 bytes and has 5"),
    "a byte too few announced": (
        every(lambda t, u, p: mbap(t, u, answer(p), more=-1)),
        "announces 4 bytes and its content has 5",
    ),
    "nothing announced": (every(lambda t, u, p: mbap(t, u, answer(p), more=-5)), "announces 0 bytes and has 5"),
    "half a reply": (
        every(lambda t, u, p: mbap(t, u, answer(p), more=0)[:-1]),
        "announces 5 bytes and stopped after 4",
    ),
    "an echo": (every(lambda t, u, p: mbap(t, u, p)), "the reply is the request itself, an echo"),
    "no byte count": (every(lambda t, u, p: mbap(t, u, p[:1])), "function 3 without byte count and values"),
    "registers for bytes": (
        every(lambda t, u, p: mbap(t, u, p[:1] + b"\1" + answer(p)[2:])),
        "byte count is 1 and that has 2 bytes of values; the device or its gateway is faulty",
    ),
    "another unit": (every(lambda t, u, p: mbap(t, 9, answer(p))), "unit 9 answers where device_id 1 was asked"),
    "another transaction": (every(lambda t, u, p: mbap(t + 7, u, answer(p))), "transaction 8 where 1 was asked"),
    "transaction 0": (every(lambda t, u, p: mbap(0, u, answer(p))), "give transaction = 'zero'"),
    "another protocol": (every(lambda t, u, p: mbap(t, u, answer(p), protocol=5)), "protocol 5 where Modbus has 0"),
    "RTU": (every(lambda t, u, p: rtu_frame(u, answer(p))), "in RTU framing; use transport = 'modbus_rtu_tcp'"),
    "HTTP": (says(b"HTTP/1.1 400 Bad Request\r\n\r\n"), r"a web server \(HTTP\) answers there; correct host and port"),
    "SSH": (says(b"SSH-2.0-OpenSSH_9.6\r\n", at_once=True), "an SSH server answers there"),
    "TLS": (says(b"\x15\x03\x03\0\x02\x02\x16"), "the port speaks TLS; use transport = 'modbus_tls'"),
    "a banner": (says(b"Welcome\r\n", at_once=True), "answers in text .'Welcome"),
    "silence": (says(b""), "nothing comes back: correct device_id and transport, or give connect_delay_s"),
}


@pytest.mark.parametrize("kind", STRANGERS)
async def test_what_answers_otherwise_is_named_with_what_to_change(kind, monkeypatch):
    monkeypatch.setattr("drivers.modbus.bus.CONNECT_PATIENCE_S", (0.2, 0.2))
    serve, words = STRANGERS[kind]
    said = await refusal(serve)
    assert re.search(words, said), said
    assert "is the rig on" not in said


@pytest.mark.parametrize(
    ("reply", "words"),
    [
        (lambda t, u, p: mbap(t, u, answer(p)), "Modbus/TCP framing; use transport = 'modbus_tcp'"),
        (lambda t, u, p: rtu_frame(5, answer(p)), "from device 5 where device_id 1 was asked"),
    ],
    ids=["Modbus/TCP", "another device"],
)
async def test_what_answers_otherwise_on_an_rtu_line_is_named(reply, words, monkeypatch):
    monkeypatch.setattr("drivers.modbus.bus.CONNECT_PATIENCE_S", (0.2, 0.2))

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while frame := await reader.read(8):
            writer.write(reply(1, frame[0], frame[1:-2]))

    assert words in await refusal(serve, kind=ModbusRtuTcpBus)


@pytest.mark.parametrize(
    ("reply", "said"),
    [
        (lambda u, p: rtu_frame(u, p), "the reply is the request itself, an echo"),
        (lambda u, p: rtu_frame(u, p) + rtu_frame(u, answer(p)), "the reply is the request itself, an echo"),
        (lambda u, p: rtu_frame(u, p[:1] + b"\0"), "byte count 0 where 2 bytes were asked; the device has no values"),
        (lambda u, p: rtu_frame(u, p[:1] + b"\1\5"), "1 bytes of values, which are no whole registers"),
    ],
    ids=["an echo", "an echo before the reply", "no values", "half a register"],
)
async def test_the_defect_of_a_reply_on_an_rtu_line_is_named(reply, said, monkeypatch):
    monkeypatch.setattr("drivers.modbus.bus.CONNECT_PATIENCE_S", (0.2, 0.2))

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while frame := await reader.read(8):
            writer.write(reply(frame[0], frame[1:-2]))

    found = await refusal(serve, kind=ModbusRtuTcpBus)
    assert said in found and "CRC" not in found


@pytest.mark.parametrize(
    ("pdu", "said"),
    [
        (b"\3\0", "answered no value (byte count 0) for holding 60; the reply is not used: the device has no values"),
        (b"\3\1\5", "answered 1 byte for holding 60, where a register has two; the reply is not used: the device"),
        (b"\3\4\0\0\0\0", "2 registers where 1 were asked (holding 60); the reply is not used: look for another"),
        (b"\4\2\0\0", "answered function 4 to function 3; the reply is not used: look for another client"),
        (b"\x83\x63", "refused holding 60: exception 99, which the protocol does not know"),
    ],
)
async def test_a_defect_of_one_reply_takes_no_other_point(pdu, said):
    def reply(tid: int, unit: int, asked_for: bytes) -> bytes:
        return mbap(tid, unit, pdu if asked_for[1:3] == b"\0\x3c" else answer(asked_for))

    async with listening(every(reply)) as port:
        bus = driver(port)
        with pytest.raises(DriverError, match=re.escape(said)):
            await bus.connect()
        readings = await bus.read()
        assert readings.quality == [Quality.GOOD, Quality.LINK_FAULT]
        assert said in (readings.fault or "")
        assert bus.reconnects == 0
        await bus.close()


@pytest.mark.parametrize("more", [-5, -1, 1, 6])
async def test_a_device_whose_lengths_are_wrong_is_read_where_the_rig_file_says_so(more):
    async with listening(every(lambda t, u, p: mbap(t, u, answer(p), more=more))) as port:
        assert (await good(port, frame_length="ignored"))[1] == [100, 160]


@pytest.mark.parametrize("more", [-1, 1, 6])
async def test_a_refusal_of_a_wrong_length_takes_no_other_point(more):
    def reply(tid: int, unit: int, pdu: bytes) -> bytes:
        if pdu[1:3] == b"\0\x3c":
            return mbap(tid, unit, bytes((pdu[0] | 0x80, 2)), more=more)
        return mbap(tid, unit, answer(pdu))

    async with listening(every(reply)) as port:
        bus = driver(port)
        with pytest.raises(DriverError, match=r"exception 2.*points that cannot be read: far"):
            await bus.connect()
        readings = await bus.read()
        assert readings.quality == [Quality.GOOD, Quality.LINK_FAULT]
        assert bus.reconnects == 0
        await bus.close()
