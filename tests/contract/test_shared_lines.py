"""Several devices on one wire: each has its own values, and one that gives no answer does not starve the others."""

from __future__ import annotations

import asyncio
import contextlib
import struct
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from drivers.rig.connection import RigConnection
from drivers.rig_file.reader import RigFileError, load_rig
from drivers.signals.points import Quality
from drivers.virtual.devices.rtu_protocol import crc, request_size
from tests.contract.wires import PseudoPair

SHARED = ("rtu over tcp", "rtu serial", "tcp gateway")
BUS = {
    "rtu over tcp": 'transport = "modbus_rtu_tcp"\nport = {port}',
    "rtu serial": 'transport = "modbus_rtu"\nserial_port = "{path}"\nserial_baud = 115200',
    "tcp gateway": 'transport = "modbus_tcp"\nport = {port}',
}


class Line:
    """Devices 1 to 3 on one line; register n of device d holds 1000 d + n. Those in `mute` say nothing."""

    def __init__(self, *, mbap: bool) -> None:
        self.mbap = mbap
        self.mute: set[int] = set()
        self.asked: list[int] = []
        self.connections = 0
        self.port = 0
        self._tasks: set[asyncio.Task[None]] = set()

    async def __aenter__(self) -> Line:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self.connections += 1
        rest = b""
        with contextlib.suppress(OSError, asyncio.CancelledError):
            while data := await reader.read(1000):
                rest += data
                while (size := 12 if self.mbap else request_size(rest)) and len(rest) >= size:
                    frame, rest = rest[:size], rest[size:]
                    body = frame[6:] if self.mbap else frame[:-2]
                    self.asked.append(body[0])
                    if body[0] in self.mute:
                        continue
                    first, count = struct.unpack(">HH", body[2:6])
                    values = [1000 * body[0] + first + k for k in range(count)]
                    reply = struct.pack(f">BBB{count}H", body[0], body[1], 2 * count, *values)
                    head = frame[:4] + struct.pack(">H", len(reply))
                    writer.write(head + reply if self.mbap else reply + crc(reply))
        writer.transport.abort()


def rig_file(folder: Path, where: str, *, timeout_s: float = 0.15) -> Path:
    parts = ['[rig]\nname = "shared"\n']
    for device in (1, 2, 3):
        parts.append(f"[bus.d{device}]\n{where}\ndevice_id = {device}\ntimeout_s = {timeout_s}\n")
        for register in range(4):
            parts.append(
                f'[[point]]\nname = "d{device}_{register}"\nbus = "d{device}"\nunit = "1"\ntable = "input"\n'
                f"address = {register}\n"
            )
    path = folder / "rig.toml"
    path.write_text("\n".join(parts), encoding="utf-8")
    return path


@contextlib.asynccontextmanager
async def shared(transport: str, folder: Path) -> AsyncIterator[tuple[Line, RigConnection]]:
    async with contextlib.AsyncExitStack() as stack:
        line = await stack.enter_async_context(Line(mbap=transport == "tcp gateway"))
        path = ""
        if transport == "rtu serial":
            path = (await stack.enter_async_context(PseudoPair(line.port))).path
        rig = load_rig(rig_file(folder, BUS[transport].format(port=line.port, path=path)))
        connection = RigConnection(rig, time.monotonic)
        stack.push_async_callback(connection.close)
        await connection.connect()
        yield line, connection


def good(connection: RigConnection, snapshot) -> set[str]:
    found = set()
    for point, value, quality in zip(connection.points, snapshot.values, snapshot.quality, strict=True):
        if quality == Quality.GOOD:
            assert value == 1000 * int(point.bus[1]) + (point.address or 0)
            found.add(point.bus)
    return found


@pytest.mark.parametrize("transport", SHARED)
async def test_devices_on_one_wire_take_turns_on_one_connection(transport, tmp_path):
    async with shared(transport, tmp_path) as (line, connection):
        for _ in range(5):
            assert good(connection, await connection.read()) == {"d1", "d2", "d3"}
        assert line.connections == 1


@pytest.mark.parametrize("transport", SHARED)
async def test_a_mute_device_does_not_starve_the_others_and_comes_back(transport, tmp_path):
    async with shared(transport, tmp_path) as (line, connection):
        line.mute = {1}
        for _ in range(3):
            assert good(connection, await connection.read()) == {"d2", "d3"}
        line.asked.clear()
        began = time.monotonic()
        ticks = 0
        while time.monotonic() < began + 1.5:
            assert good(connection, await connection.read()) == {"d2", "d3"}
            ticks += 1
            await asyncio.sleep(0.05)
        assert line.asked.count(1) <= 2
        assert line.asked.count(2) == line.asked.count(3) == ticks
        line.mute = set()
        back = time.monotonic()
        while good(connection, await connection.read()) != {"d1", "d2", "d3"}:
            assert time.monotonic() - back < 2.0
            await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("serial_baud = 19200", "serial_baud = 9600", "has serial_baud 9600 and bus d1, on the same wire, 19200"),
        ("device_id = 2", "device_id = 1", "bus d2 and bus d1 are the same device on the same wire"),
        ("stop_bits = 1", "stop_bits = 3", "stop_bits"),
        ("device_id = 3", "device_id = 0", "device_id"),
    ],
)
def test_sections_that_share_a_wire_must_agree_on_it(tmp_path, key, value, said):
    where = 'transport = "modbus_rtu"\nserial_port = "/dev/ttyUSB0"\nserial_baud = 19200\nstop_bits = 1'
    path = rig_file(tmp_path, where)
    assert len(load_rig(path).bus) == 3
    first, rest = path.read_text(encoding="utf-8").split("[bus.d2]")
    changed = rest.replace(key, value, 1)
    assert changed != rest
    path.write_text(first + "[bus.d2]" + changed, encoding="utf-8")
    with pytest.raises(RigFileError, match=said) as caught:
        load_rig(path)
    assert "rig.toml, line " in str(caught.value)


def test_what_all_devices_of_a_line_ask_for_must_fit_on_it(tmp_path):
    from drivers.modbus.budget import overloads, polling

    where = 'transport = "modbus_rtu"\nserial_port = "/dev/ttyUSB0"\nserial_baud = 600'
    rig = load_rig(rig_file(tmp_path, where))
    polled = [polling(name, bus, rig.point) for name, bus in rig.bus.items()]
    assert all((one.line_s or 0.0) < rig.period_s for one in polled)
    said = [what for _, what in overloads(rig, polled)]
    assert len(said) == 3 and "bus d1 (with d2, d3): a tick's reads take 1." in said[0]


def test_a_serial_line_is_shown_with_its_speed_and_what_a_tick_takes_of_it(tmp_path):
    from click.testing import CliRunner

    from hil.cli.rig_commands.check import command

    where = 'transport = "modbus_rtu"\nserial_port = "/dev/ttyUSB0"\nserial_baud = 9600\nparity = "none"\nstop_bits = 2'
    done = CliRunner().invoke(command, [str(rig_file(tmp_path, where))])
    assert done.exit_code == 0, done.output
    assert "d2: Modbus RTU /dev/ttyUSB0, 9600 bit/s 8N2, device 2" in done.output
    # 8 bytes asked and 13 answered
    assert "1 read and 21 bytes every 1 s, 0.032 s of the line at 9600 bit/s" in done.output
