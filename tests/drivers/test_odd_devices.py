"""Devices that answer oddly, and services that are no Modbus: values where these are sure, else the defect by name."""

from __future__ import annotations

import asyncio
import contextlib
import re
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest

from drivers.modbus.bus import ModbusBus
from drivers.modbus.protocol.pymodbus_codec import rtu_frame
from drivers.rig.watch import RigWatch
from drivers.rig_file.bus_sections import ModbusBusSection, ModbusRtuTcpBus, ModbusTcpBus
from drivers.rig_file.model import Point
from drivers.signals.points import DriverError, Quality
from tests.drivers.faulty_server import FaultyServer, correct

POINTS = (
    Point(name="a", bus="b", unit="1", table="holding", address=0),
    Point(name="far", bus="b", unit="1", table="holding", address=60),
    Point(name="set", bus="b", unit="1", table="holding", address=70, access="rw"),
)
Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


@contextlib.asynccontextmanager
async def listening(serve: Serve) -> AsyncIterator[int]:
    tasks: set[asyncio.Task[None]] = set()

    async def served(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        tasks.add(task)
        task.add_done_callback(tasks.discard)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            await serve(reader, writer)
        writer.close()

    server = await asyncio.start_server(served, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        for task in list(tasks):
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def asked(reader: asyncio.StreamReader) -> tuple[int, int, bytes]:
    """Transaction, unit and PDU of the next request."""
    tid, _, length, unit = struct.unpack(">HHHB", await reader.readexactly(7))
    return tid, unit, await reader.readexactly(length - 1)


def answer(pdu: bytes) -> bytes:
    """A reply in which register n holds 100 + n."""
    code, address, count = struct.unpack(">BHH", pdu[:5])
    return struct.pack(f">BB{count}H", code, 2 * count, *(100 + address + k for k in range(count)))


def every(reply: Callable[[int, int, bytes], bytes]) -> Serve:
    """A device that answers each request with the bytes of `reply`."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            writer.write(reply(*await asked(reader)))

    return serve


def says(data: bytes, *, at_once: bool = False) -> Serve:
    """A service that sends `data` when it is connected to, or once something has come."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not at_once:
            await reader.read(1)
        writer.write(data)
        await reader.read()

    return serve


def mbap(tid: int, unit: int, pdu: bytes, *, protocol: int = 0, more: int = 0) -> bytes:
    return struct.pack(">HHHB", tid, protocol, len(pdu) + 1 + more, unit) + pdu


def driver(port: int, kind: type[ModbusBusSection] = ModbusTcpBus, **changes: object) -> ModbusBus:
    transport = "modbus_rtu_tcp" if kind is ModbusRtuTcpBus else "modbus_tcp"
    config = kind(transport=transport, port=port, **{"timeout_s": 0.15, **changes})
    return ModbusBus("b", config, POINTS, time.monotonic)


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


async def good(port: int, **changes: object) -> tuple[ModbusBus, list[float]]:
    bus = driver(port, **changes)
    try:
        await bus.connect()
        for _ in range(4):
            readings = await bus.read()
            assert (readings.quality, readings.fault) == ([Quality.GOOD] * 2, None)
        return bus, readings.values
    finally:
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


MANY = tuple(Point(name=f"p{n}", bus="b", unit="1", table="input", address=n) for n in range(40))


def refusing(code: int, refused: Callable[[int, int], bool], asked_for: list[int]) -> Serve:
    """A device that refuses with exception `code` the reads for whose address and count `refused` is True."""

    def reply(tid: int, unit: int, pdu: bytes) -> bytes:
        _, address, count = struct.unpack(">BHH", pdu[:5])
        asked_for.append(count)
        return mbap(tid, unit, bytes((pdu[0] | 0x80, code)) if refused(address, count) else answer(pdu))

    return every(reply)


@pytest.mark.parametrize("code", [2, 3, 4, 8])
async def test_one_register_that_a_device_refuses_takes_no_other_whatever_the_exception(code):
    counts: list[int] = []
    async with listening(refusing(code, lambda at, count: at <= 5 < at + count, counts)) as port:
        bus = ModbusBus("b", ModbusTcpBus(transport="modbus_tcp", port=port), MANY, time.monotonic)
        with pytest.raises(DriverError, match=rf"refused input 0 to 39: exception {code}.*cannot be read: p5$"):
            await bus.connect()
        readings = await bus.read()
        await bus.close()
    assert [n for n, quality in enumerate(readings.quality) if quality != Quality.GOOD] == [5]
    assert "input 5" in (readings.fault or "")


async def test_a_device_that_reads_few_registers_at_once_is_read_in_small_parts():
    counts: list[int] = []
    async with listening(refusing(3, lambda at, count: count > 6, counts)) as port:
        bus = ModbusBus("b", ModbusTcpBus(transport="modbus_tcp", port=port), MANY, time.monotonic)
        await bus.connect()
        readings = await bus.read()
        await bus.close()
    assert set(readings.quality) == {Quality.GOOD} and readings.fault is None


@pytest.mark.parametrize("code", [1, 10, 11])
async def test_a_refusal_that_a_smaller_read_cannot_help_is_not_split(code):
    counts: list[int] = []
    async with listening(refusing(code, lambda at, count: True, counts)) as port:
        bus = ModbusBus("b", ModbusTcpBus(transport="modbus_tcp", port=port), MANY, time.monotonic)
        with pytest.raises(DriverError, match=f"exception {code}"):
            await bus.connect()
        await bus.close()
    assert set(counts) == {40}


async def test_a_device_that_fails_as_a_whole_is_asked_for_few_parts_a_tick_and_for_the_whole_again_later():
    counts: list[int] = []
    now, fails = [0.0], [False]
    async with listening(refusing(4, lambda at, count: fails[0], counts)) as port:
        bus = ModbusBus("b", ModbusTcpBus(transport="modbus_tcp", port=port), MANY, lambda: now[0])
        await bus.connect()
        fails[0] = True
        counts.clear()
        readings = await bus.read()
        assert Quality.GOOD not in readings.quality
        assert len(counts) < 20
        for _ in range(10):
            await bus.read()
        fails[0], now[0] = False, 31.0
        counts.clear()
        readings = await bus.read()
        await bus.close()
    assert set(readings.quality) == {Quality.GOOD} and counts == [40]


async def test_a_refused_write_is_named_with_its_function():
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while True:
            tid, unit, pdu = await asked(reader)
            writer.write(mbap(tid, unit, answer(pdu) if pdu[0] == 3 else bytes((pdu[0] | 0x80, 1))))

    async with listening(serve) as port:
        bus = driver(port)
        await bus.connect()
        said = "refused to write holding 70 with function 6: exception 1, function not supported"
        with pytest.raises(DriverError, match=said):
            await bus.write({"set": 1.0})
        await bus.close()


@pytest.mark.parametrize("by", ["close", "abort"])
async def test_a_device_that_closes_after_each_reply_is_read_without_a_fault(by):
    written: list[int] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tid, unit, pdu = await asked(reader)
        if pdu[0] == 6:
            written.append(pdu[4])
        writer.write(mbap(tid, unit, pdu if pdu[0] == 6 else answer(pdu)))
        await writer.drain()
        if by == "abort":
            await asyncio.sleep(0.01)
            writer.transport.abort()

    async with listening(serve) as port:
        bus = driver(port)
        await bus.connect()
        for beat in range(5):
            readings = await bus.read()
            assert (readings.quality, readings.fault) == ([Quality.GOOD] * 2, None)
            await bus.write({"set": beat})
        await bus.close()
    assert written == [0, 1, 2, 3, 4]
    assert bus.reconnects == 0


async def test_a_device_that_is_deaf_after_connecting_is_waited_for():
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        listens = time.monotonic() + 0.7
        while True:
            tid, unit, pdu = await asked(reader)
            if time.monotonic() > listens:
                writer.write(mbap(tid, unit, answer(pdu)))

    async with listening(serve) as port:
        await good(port)


async def test_no_request_goes_out_before_the_connect_delay_is_over():
    first: list[float] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        began = time.monotonic()
        while True:
            tid, unit, pdu = await asked(reader)
            first.append(time.monotonic() - began)
            writer.write(mbap(tid, unit, answer(pdu)))

    async with listening(serve) as port:
        await good(port, connect_delay_s=0.5)
    assert first[0] > 0.45


@pytest.mark.parametrize("first", ["closed", "mute"])
async def test_a_device_that_serves_the_second_connection_only_is_read(first, monkeypatch):
    monkeypatch.setattr("drivers.modbus.bus.CONNECT_PATIENCE_S", (0.2, 1.0))
    connections: list[int] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.append(1)
        if len(connections) == 1:
            if first == "mute":
                await reader.read()
            return
        while True:
            tid, unit, pdu = await asked(reader)
            writer.write(mbap(tid, unit, answer(pdu)))

    async with listening(serve) as port:
        await good(port)


async def test_a_missed_deadline_is_not_told_as_a_rig_that_is_off(monkeypatch):
    monkeypatch.setattr("drivers.modbus.bus.CONNECT_PATIENCE_S", (0.1, 0.1))
    from drivers.rig_file.model import Rig

    async with listening(every(lambda t, u, p: mbap(t, u, answer(p), more=1))) as port:
        config = {"transport": "modbus_tcp", "port": port, "timeout_s": 0.1}
        rig = Rig.model_validate({"name": "r", "bus": {"b": config}, "point": [p.model_dump() for p in POINTS[:1]]})
        async with RigWatch(rig) as watch:
            (said,) = watch.faults()["b"]
    assert "announces 6 bytes and has 5" in said


async def test_a_reply_that_lay_in_the_queue_while_the_process_was_stopped_is_asked_for_again(monkeypatch):
    asked_for: list[bytes] = []

    def watched(server, tid, unit, pdu):
        asked_for.append(pdu)
        return correct(server, tid, unit, pdu)

    async with FaultyServer(watched) as server:
        bus = driver(server.port)
        await bus.connect()
        asked_for.clear()
        stopped = Stopped(after=1)
        monkeypatch.setattr("drivers.modbus.link.steady_s", stopped)
        monkeypatch.setattr(bus.link, "_late", 3)
        server.behaviour = stopped.wrapping(watched)
        readings = await bus.read()
        assert (readings.quality, readings.fault) == ([Quality.GOOD] * 2, None)
        assert len(asked_for) == 3
        assert (bus.missed, bus.reconnects) == (0, 0)
        stopped.stops = 9
        readings = await bus.read()
        assert readings.quality == [Quality.LINK_FAULT] * 2
        assert "too late to be used" in (readings.fault or "")
        await bus.close()


class Stopped:
    """A steady clock that jumps by 5 s while a reply is under way, for the first `after` replies."""

    def __init__(self, after: int) -> None:
        self.stops = after
        self.ahead_s = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.ahead_s

    def wrapping(self, behaviour):
        def answer(*arguments):
            if self.stops:
                self.stops -= 1
                self.ahead_s += 5.0
            return behaviour(*arguments)

        return answer


async def test_a_read_that_reconnects_is_cancelled_though_the_connection_stands():
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        tid, unit, pdu = await asked(reader)
        writer.write(mbap(tid, unit, answer(pdu)))
        await writer.drain()

    async with listening(serve) as port:
        bus = driver(port)
        await bus.connect()
        await asyncio.sleep(0.05)  # the device closes
        opened = bus.link.open

        async def opened_and_cancelled(where: str) -> None:
            await opened(where)
            reading.cancel()

        bus.link.open = opened_and_cancelled
        reading = asyncio.ensure_future(bus.read())
        await asyncio.wait((reading,), timeout=5.0)
        await bus.close()
    assert reading.cancelled()
