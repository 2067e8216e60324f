"""Modbus servers that we did not write, each in a process of its own: register n holds 100 + n, as do the inputs."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]

PYMODBUS_TCP = """
import socket
from pyModbusTCP.server import DataBank, ModbusServer
with socket.socket() as probe:
    probe.bind(("127.0.0.1", 0))
    port = probe.getsockname()[1]
bank = DataBank(coils_size=64, d_inputs_size=64, h_regs_size=64, i_regs_size=64)
bank.set_holding_registers(0, [100 + n for n in range(64)])
bank.set_input_registers(0, [100 + n for n in range(64)])
bank.set_coils(0, [n % 3 == 0 for n in range(64)])
bank.set_discrete_inputs(0, [n % 3 == 0 for n in range(64)])
server = ModbusServer("127.0.0.1", port, data_bank=bank, no_block=True)
server.start()
print(port, flush=True)
import sys; sys.stdin.read()
"""
PYMODBUS = """
import asyncio
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice
async def main():
    words = [100 + n for n in range(64)]
    bits = [n % 3 == 0 for n in range(64)]
    tables = [[SimData(0, values=bits, datatype=DataType.BITS)] for _ in range(2)]
    tables += [[SimData(0, values=words, datatype=DataType.REGISTERS)] for _ in range(2)]
    device = SimDevice(id=1, simdata=tuple(tables))
    server = ModbusTcpServer(device, address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    print(server.transport.sockets[0].getsockname()[1], flush=True)
    await asyncio.sleep(3600)
asyncio.run(main())
"""
LIBMODBUS = "import sys; from hil.bench.peers.libmodbus import serve; serve(sys.argv[1] if len(sys.argv) > 1 else None)"
MODBUS_SERIAL = """
const { ServerTCP } = require("modbus-serial");
const registers = Array.from({ length: 64 }, (_, n) => 100 + n);
const vector = {
  getInputRegister: (address) => registers[address],
  getHoldingRegister: (address) => registers[address],
  getCoil: (address) => address % 3 === 0,
  getDiscreteInput: (address) => address % 3 === 0,
  setRegister: (address, value) => { registers[address] = value; },
};
const net = require("net");
const probe = net.createServer().listen(0, "127.0.0.1", () => {
  const port = probe.address().port;
  probe.close(() => {
    const server = new ServerTCP(vector, { host: "127.0.0.1", port, unitID: 1 });
    server.on("initialized", () => console.log(port));
  });
});
"""


def node_modules() -> str | None:
    """Folder of globally installed packages of node, where `modbus-serial` is among them."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return None
    places = [os.environ.get("NODE_PATH", "")]
    done = subprocess.run(["npm", "root", "--global"], capture_output=True, text=True, timeout=60, check=False)
    places.append(done.stdout.strip())
    return next((place for place in places if place and Path(place, "modbus-serial").is_dir()), None)


@contextlib.contextmanager
def _running(command: list[str], environment: dict[str, str] | None = None) -> Iterator[int]:
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=PROJECT,
        env={**os.environ, "PYTHONPATH": str(PROJECT), **(environment or {})},
    )
    assert process.stdout is not None and process.stdin is not None
    try:
        line = process.stdout.readline()
        assert line.strip().isdigit(), f"{command[0]} did not start"
        yield int(line)
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stdin.close()


def python_server(code: str, *arguments: str) -> contextlib.AbstractContextManager[int]:
    """A server in Python; its port."""
    return _running([sys.executable, "-c", code, *arguments])


@contextlib.contextmanager
def server(name: str) -> Iterator[int]:
    """A server by name; its port. Skips where the stranger is not here."""
    if name == "pyModbusTCP":
        pytest.importorskip("pyModbusTCP", reason="pyModbusTCP is not installed")
        made = python_server(PYMODBUS_TCP)
    elif name == "pymodbus":
        made = python_server(PYMODBUS)
    elif name == "libmodbus":
        need_libmodbus()
        made = python_server(LIBMODBUS)
    else:
        modules = node_modules()
        if modules is None:
            pytest.skip("modbus-serial is not installed (npm install --global modbus-serial)")
        made = _running(["node", "-e", MODBUS_SERIAL], {"NODE_PATH": modules})
    with made as port:
        yield port


def need_libmodbus() -> None:
    """Skip where libmodbus is not here."""
    from hil.bench.peers.libmodbus import NoLibmodbusError, library

    try:
        library()
    except NoLibmodbusError as error:
        pytest.skip(str(error))
