"""The virtual rig over every Modbus transport: of the rig file only the bus section differs."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from drivers.rig.connection import RigConnection
from drivers.rig_file.reader import load_rig
from drivers.signals.points import Quality
from drivers.virtual.rig import start_virtual_rig
from hil.bench.faults.tls import Certificates
from hil.run.outputs.safing import write_safe
from tests.contract.wires import TRANSPORTS

RIGS = Path(__file__).resolve().parents[2] / "profiles" / "rigs"
TCP = 'transport = "modbus_tcp"\nhost = "127.0.0.1"\nport = 5020\n'


@pytest.mark.parametrize("transport", TRANSPORTS)
async def test_the_virtual_rig_is_read_written_and_armed(transport, tmp_path: Path, certificates: Certificates | None):
    if transport == "tls" and certificates is None:
        pytest.skip("certificates are made by the openssl program, which is not installed")
    tls = certificates.rig if transport == "tls" and certificates is not None else None
    server = "pymodbus" if "pymodbus" in transport else "own"
    transport = transport.removesuffix(" to pymodbus")
    async with await start_virtual_rig(period_s=0.1, rtu_port=0, serial=True, tls=tls, server=server) as rig:
        section = {
            "tcp": f'transport = "modbus_tcp"\nport = {rig.modbus_port}\n',
            "tls": f'transport = "modbus_tls"\nport = {rig.modbus_port}\n',
            "tcp, transaction 0": f'transport = "modbus_tcp"\ntransaction = "zero"\nport = {rig.modbus_port}\n',
            "rtu over tcp": f'transport = "modbus_rtu_tcp"\nport = {rig.rtu_port}\n',
            "rtu serial": f'transport = "modbus_rtu"\nserial_port = "{rig.serial_port}"\n',
        }[transport] + "read_write = true\n"
        if tls is not None and certificates is not None:
            section += "".join(f'{key} = "{path}"\n' for key, path in certificates.harness.items())
        text = (RIGS / "virtual.toml").read_text(encoding="utf-8")
        assert TCP in text
        path = tmp_path / "rig.toml"
        path.write_text(
            text.replace(TCP, section)
            .replace("port = 29536", f"port = {rig.can_port}")
            .replace('"thermocouples.dbc"', f'"{RIGS / "thermocouples.dbc"}"'),
            encoding="utf-8",
        )
        connection = RigConnection(load_rig(path), time.monotonic)
        await connection.connect()
        try:
            await connection.first_complete(5.0)
            await connection.write({"heater_power_set": 400.0, "pump_speed_set": 100.0, "heartbeat": 1})
            await connection.write({"arm": 1})
            assert await connection.read_back(("heater_power_set", "arm")) == {"heater_power_set": 400.0, "arm": 1.0}
            safe = {p.name: float(p.safe_value or 0.0) for p in connection.rig.setpoints}
            assert await write_safe(connection, safe) == ""
            assert await connection.read_back(tuple(safe)) == safe
            await connection.write({"heater_power_set": 400.0})
            for beat in range(2, 20):
                await connection.write({"heartbeat": beat})
                snapshot = await connection.read()
                assert set(snapshot.quality) == {Quality.GOOD}, snapshot.faults
                await asyncio.sleep(0.05)
            values = dict(zip((p.name for p in connection.points), snapshot.values, strict=True))
            assert values["heater_power"] > 10.0 and values["flow"] > 0.5
        finally:
            await connection.close()
