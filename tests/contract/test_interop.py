"""Both directions with programs and libraries that we did not write; what is not installed is left out by name."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivers.modbus.bus import ModbusBus
from drivers.rig_file.bus_sections import ModbusBusSection, ModbusRtuBus, ModbusTcpBus
from drivers.rig_file.model import Point
from drivers.signals.points import DeviceExceptionError, Quality
from drivers.virtual.rig import VirtualRig, start_virtual_rig
from tests.contract.strangers import LIBMODBUS, need_libmodbus, python_server, server

PROJECT = Path(__file__).resolve().parents[2]
DBC = PROJECT / "profiles" / "rigs" / "thermocouples.dbc"
POINTS = (
    *(Point(name=f"i{a}", bus="b", unit="1", table="input", address=a) for a in (0, 1, 7, 30)),
    *(Point(name=f"d{a}", bus="b", unit="1", table="discrete", address=a) for a in (0, 1, 3)),
    *(Point(name=f"h{a}", bus="b", unit="1", table="holding", address=a, access="rw") for a in (10, 11)),
)


async def used(config: ModbusBusSection, points: tuple[Point, ...] = POINTS) -> dict[str, float]:
    """Our client reads, writes, reads back, and is refused what there is not; return what a second client reads."""
    bus = ModbusBus("stranger", config, points, time.monotonic)
    try:
        await bus.connect()
        for _ in range(20):
            readings = await bus.read()
            expected = [100.0, 101.0, 107.0, 130.0, 1.0, 0.0, 1.0][: len(bus.points)]
            found = dict(zip((p.name for p in bus.points), readings.values, strict=True))
            assert [found[p.name] for p in points if p.is_polled] == expected, readings.fault
            assert set(readings.quality) == {Quality.GOOD}
        await bus.write({"h10": 4321})
        assert await bus.read_back(("h10", "h11")) == {"h10": 4321, "h11": 111}
        await bus.write({"h10": 1, "h11": 65535})
        assert await bus.read_back(("h10", "h11")) == {"h10": 1, "h11": 65535}
    finally:
        await bus.close()
    beyond = (Point(name="x", bus="b", unit="1", table="input", address=60_000),)
    bus = ModbusBus("stranger", config, beyond, time.monotonic)
    try:
        with pytest.raises(DeviceExceptionError, match="exception 2, address does not exist"):
            await bus.connect()
    finally:
        await bus.close()
    bus = ModbusBus("second", config, points, time.monotonic)
    try:
        await bus.connect()
        return dict(await bus.read_back(("h10", "h11")))
    finally:
        await bus.close()


@pytest.mark.parametrize("stranger", ["pyModbusTCP", "libmodbus", "pymodbus"])
async def test_our_client_on_the_server_of(stranger):
    with server(stranger) as port:
        held = await used(ModbusTcpBus(transport="modbus_tcp", port=port, timeout_s=1.0))
    assert held == {"h10": 1, "h11": 65535}


@pytest.mark.parametrize("stranger", ["pyModbusTCP", "libmodbus", "pymodbus"])
async def test_function_23_on_the_server_of(stranger):
    with server(stranger) as port:
        config = ModbusTcpBus(transport="modbus_tcp", port=port, timeout_s=1.0, read_write=True)
        bus = ModbusBus("stranger", config, POINTS, time.monotonic)
        try:
            await bus.connect()
            for value in (4321.0, 1.0):
                held = await bus.write_and_read_back({"h10": value}, ("h10", "h11"))
                assert held == {"h10": value, "h11": 111.0}
            assert not bus.exceptions
        finally:
            await bus.close()


async def test_our_client_on_the_npm_server_modbus_serial():
    with server("modbus-serial") as port:
        bus = ModbusBus(
            "stranger", ModbusTcpBus(transport="modbus_tcp", port=port, timeout_s=2.0), POINTS, time.monotonic
        )
        try:
            await bus.connect()
            readings = await bus.read()
            found = dict(zip((p.name for p in bus.points), readings.values, strict=True))
            assert [found[n] for n in ("i0", "i1", "i7", "i30", "d0", "d1", "d3")] == [100, 101, 107, 130, 1, 0, 1]
            await bus.write({"h10": 4321})
            await bus.write({"h10": 4321, "h11": 65535})
            assert await bus.read_back(("h10", "h11")) == {"h10": 4321, "h11": 65535}
        finally:
            await bus.close()


async def test_our_client_on_libmodbus_on_a_serial_line():
    need_libmodbus()
    ours, theirs = _null_modem()
    try:
        with python_server(LIBMODBUS, theirs.path):
            line = ModbusRtuBus(
                transport="modbus_rtu", serial_port=ours.path, serial_baud=115200, parity="none", timeout_s=1.0
            )
            assert await used(line) == {"h10": 1, "h11": 65535}
    finally:
        ours.close()
        theirs.close()


class _End:
    """One end of a null modem: a pseudo-terminal whose bytes come out of the other end's."""

    def __init__(self) -> None:
        import tty

        self.descriptor, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.descriptor, False)
        self.path = os.ttyname(self._slave)

    def join(self, other: _End) -> None:
        def pump() -> None:
            with contextlib.suppress(OSError):
                os.write(other.descriptor, os.read(self.descriptor, 4096))

        asyncio.get_running_loop().add_reader(self.descriptor, pump)

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self.descriptor)
        os.close(self.descriptor)
        os.close(self._slave)


def _null_modem() -> tuple[_End, _End]:
    one, other = _End(), _End()
    one.join(other)
    other.join(one)
    return one, other


# Their clients on the virtual rig -----------------------------------------------------------------------------------


def _mbpoll(*arguments: str) -> str:
    done = subprocess.run(
        ["mbpoll", "-a", "1", "-0", "-1", *arguments], capture_output=True, text=True, timeout=20, check=False
    )
    return done.stdout + done.stderr


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (Debian package mbpoll)")
@pytest.mark.parametrize("transport", ["tcp", "rtu serial"])
async def test_mbpoll_on_the_virtual_rig(transport):
    def drive(rig: VirtualRig) -> None:
        where, place = (
            (["-m", "tcp", "-p", str(rig.modbus_port)], rig.host)
            if transport == "tcp"
            else (["-m", "rtu", "-b", "115200", "-P", "none"], str(rig.serial_port))
        )
        assert "Written 3 references" in _mbpoll(*where, "-t", "4", "-r", "0", place, "7500", "1000", "700")
        holding = _mbpoll(*where, "-t", "4", "-r", "0", "-c", "6", place)
        assert [line.split()[-1] for line in holding.splitlines() if line.startswith("[")] == [
            "7500",
            "1000",
            "700",
            "0",
            "100",
            "0",
        ]
        assert "Illegal data address" in _mbpoll(*where, "-t", "3", "-r", "12", "-c", "1", place)
        assert "Illegal data value" in _mbpoll(*where, "-t", "4", "-r", "0", place, "10001")

    async with await start_virtual_rig(serial=True) as rig:
        await asyncio.to_thread(drive, rig)


@pytest.mark.parametrize("transport", ["tcp", "rtu serial"])
async def test_libmodbus_on_the_virtual_rig(transport):
    need_libmodbus()
    from hil.bench.peers.libmodbus import Client

    def drive(rig: VirtualRig) -> None:
        client = Client.tcp(rig.modbus_port) if transport == "tcp" else Client.rtu(str(rig.serial_port))
        try:
            client.write(0, [5000, 800, 600])
            assert client.read_holdings(0, 6) == [5000, 800, 600, 0, 100, 0]
            assert len(client.read_inputs(0, 12)) == 12
            with pytest.raises(OSError, match="Illegal data address"):
                client.read_inputs(11, 2)
        finally:
            client.close()

    async with await start_virtual_rig(serial=True) as rig:
        await asyncio.to_thread(drive, rig)


async def test_pymodbus_on_the_virtual_rigs_serial_line():
    from pymodbus.client import ModbusSerialClient

    def drive(rig: VirtualRig) -> None:
        client = ModbusSerialClient(str(rig.serial_port), baudrate=115200, timeout=1)
        try:
            assert client.connect()
            assert not client.write_registers(0, [5000, 800, 600], device_id=1).isError()
            assert client.read_holding_registers(0, count=6, device_id=1).registers == [5000, 800, 600, 0, 100, 0]
            assert client.read_input_registers(11, count=2, device_id=1).exception_code == 2
        finally:
            client.close()

    async with await start_virtual_rig(serial=True) as rig:
        await asyncio.to_thread(drive, rig)


# Their listeners on our CAN hub -------------------------------------------------------------------------------------


async def test_the_logger_of_python_can_on_our_hub(tmp_path):
    log = tmp_path / "frames.asc"

    def logged() -> list[int]:
        text = log.read_text(encoding="utf-8") if log.exists() else ""
        return [text.count(f" {identifier} ") for identifier in ("181", "281", "381")]

    async with await start_virtual_rig(period_s=0.1) as rig:
        arguments = ["-i", "socketcand", "-c", "vcan0", "--bus-kwargs", "host=127.0.0.1", f"port={rig.can_port}"]
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "can.logger",
            *arguments,
            "-f",
            str(log),
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.DEVNULL,
        )
        # Its end is not ours to test: what it writes out while it runs is enough, and it is killed then.
        try:
            async with asyncio.timeout(60.0):
                while min(logged()) < 5:
                    await asyncio.sleep(0.2)
        finally:
            process.kill()
            await process.wait()
    assert min(logged()) >= 5


async def test_the_monitor_of_cantools_on_our_hub():
    async with await start_virtual_rig(period_s=0.1) as rig:
        shown = await asyncio.to_thread(_monitored, rig.can_port)
    for text in ("TC_A", "T_heater", "T_tank", "degC"):
        assert text in shown


def _monitored(port: int) -> str:
    """What `cantools monitor` draws on a terminal within a few seconds."""
    command = ["-m", "cantools", "monitor", "-i", "socketcand", "-c", "vcan0", "--bus-kwargs", "host=127.0.0.1"]
    command += [f"port={port}", "--", str(DBC)]
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "LINES": "40", "COLUMNS": "120"}
    process = subprocess.Popen(
        [sys.executable, *command], stdin=theirs, stdout=theirs, stderr=theirs, env=environment, start_new_session=True
    )
    os.close(theirs)
    shown = b""
    end = time.monotonic() + 15.0
    try:
        while time.monotonic() < end and not all(word in shown for word in (b"TC_A", b"T_heater", b"T_tank")):
            if select.select([ours], [], [], 0.2)[0]:
                try:
                    shown += os.read(ours, 65536)
                except OSError:
                    break
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    return shown.decode("utf-8", "replace")
