"""Process of a served rig: its ports, its time and its end.

Ports of the rig file are served as they are, or on free ones; serial lines become pseudo-terminals, and CAN of any kind
becomes socketcand. The readiness line on standard output names the address of each bus.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from drivers.rig_file import CanBus, ModbusRtuBus, ModbusRtuTcpBus, ModbusTcpBus, Rig, wire_of_bus
from drivers.signals import DriverError
from drivers.virtual.described.plant import PlantModel
from drivers.virtual.described.rig import DescribedRig
from drivers.virtual.devices import (
    CanConnection,
    CanHub,
    ControlConnection,
    ControlledRig,
    ModbusServer,
    end_with_parent,
    frame_text,
    listen,
    port_of,
    say,
)

HOST = "127.0.0.1"
_PLAIN = {"parity": "none", "stop_bits": 1}
"""Character format that every pseudo-terminal takes."""
_MOST_REPEATS = 100
"""Most frames of a message within a step."""


@dataclass(frozen=True, slots=True)
class ServeOptions:
    """Options of a served rig.

    Attributes
    ----------
    mode
        Real time, `speed` times as fast, or granted step by step on the control port.
    speed
        Factor to real time, in modes real and scaled.
    control_port
        Port of the control line; 0 takes a free one.
    free_ports
        Serve each bus on a free port of 127.0.0.1; False serves at the addresses of the rig file.
    """

    mode: Literal["real", "scaled", "lockstep"] = "real"
    speed: float = 1.0
    control_port: int = 0
    free_ports: bool = True


class _Serving(ControlledRig):
    """Served rig behind its control port."""

    def __init__(self, rig: DescribedRig, options: ServeOptions, epoch_s: float) -> None:
        super().__init__(options.mode, rig.rig.period_s, rig.step_s / options.speed)
        self.rig, self._epoch_s = rig, epoch_s
        self.hubs: dict[str, CanHub] = {}

    @property
    def time_s(self) -> float:
        """Rig time, s."""
        return self.rig.time_s

    def cycle(self) -> None:
        """Advance by a period of the rig file, then send each frame once."""
        for name in self._advanced(self.rig.steps_of_a_period):
            self._send(name)

    def tick(self) -> None:
        """Advance by a step, and send each frame as often as its cycle time asks."""
        for name in self._advanced(1):
            self._send(name)
            self._repeat(name)

    def restart(self) -> None:
        """Lose the memory of the devices; their plant goes on."""
        self.rig.restart()

    def _advanced(self, steps: int) -> Iterable[str]:
        """Advance by some steps; return the CAN buses that have frames to send then, none where the plant failed."""
        try:
            for _ in range(steps):
                self.rig.step()
        except DriverError as error:
            self.fail(error)
            return ()
        return self.hubs

    def _repeat(self, name: str) -> None:
        """Send the frames of a bus again within the step, where the DBC gives a shorter cycle time."""
        fastest_s = self.rig.encoders[name].fastest_s
        if not math.isfinite(fastest_s) or fastest_s >= self.rig.step_s:
            return
        times = min(math.ceil(self.rig.step_s / fastest_s), _MOST_REPEATS)
        for k in range(1, times):
            part = k / times
            asyncio.get_running_loop().call_later(part * self._tick_s, self._send, name, part * self.rig.step_s)

    def _send(self, name: str, later_s: float = 0.0) -> None:
        hub = self.hubs[name]
        if not hub.listeners:
            return
        stamp = self._epoch_s + self.rig.time_s + later_s
        for frame in self.rig.frames(name):
            identifier = f"{frame.identifier:08X}" if frame.extended else f"{frame.identifier:03X}"
            hub.publish(frame_text(identifier, stamp, frame.data), 1)


async def serve_described(
    rig: Rig, file: Path, plant: PlantModel, options: ServeOptions, about: Mapping[str, Any] | None = None
) -> int:
    """Serve the devices of a rig file until the parent process ends; return an exit code.

    Parameters
    ----------
    rig, file
        The rig and its file.
    plant
        Plant behind the devices.
    options
        Time and ports.
    about
        Further entries of the readiness line.

    Raises
    ------
    ConfigurationError
        A point cannot be served.
    SystemExit
        A port cannot be opened; the readiness line says which.
    """
    serving = _Serving(DescribedRig(rig, file, plant), options, time.time())
    sections: dict[str, dict[str, Any]] = {}
    clients: list[asyncio.Server] = []
    wires: dict[str, list[str]] = {}
    for name, wire in wire_of_bus(rig).items():
        wires.setdefault(wire, []).append(name)
    for names in wires.values():
        sections |= await _open_wire(serving, rig, names, options.free_ports)
    for name, bus in rig.bus.items():
        if isinstance(bus, CanBus):
            hub = serving.hubs[name] = CanHub(time.time, bus.channel)
            host, port = (HOST, 0) if options.free_ports else (bus.host, bus.port)
            server = await listen(lambda hub=hub: CanConnection(hub), host, port, f"CAN (bus {name})")  # type: ignore[misc]
            clients.append(server)
            sections[name] = {"transport": "socketcand", "host": host, "port": port_of(server), "channel": bus.channel}
    control = await listen(lambda: ControlConnection(serving), HOST, options.control_port, "control")
    end_with_parent(serving.stop)
    if options.mode != "lockstep":
        serving.run_free()
    say(event="ready", control_port=port_of(control), sections=sections, **(about or {}))
    await serving.stop.wait()
    serving.hold()
    _close(serving, [*clients, control])
    await asyncio.sleep(0)
    say(event="ended", reason=serving.ended_because, t=serving.rig.time_s)
    return int(serving.failed)


async def _open_wire(serving: _Serving, rig: Rig, names: list[str], free: bool) -> dict[str, dict[str, Any]]:
    """Open the port or line that some buses share; return the address of each as keys of its section."""
    first = rig.bus[names[0]]
    devices = {rig.bus[name].device_id: serving.rig.memories[name] for name in names}  # type: ignore[union-attr]
    called = f"Modbus (bus {', '.join(names)})"
    if isinstance(first, ModbusRtuBus):
        server = ModbusServer(devices, HOST, None, None, name=called)
        server.open_line()
        assert server.line is not None
        section: dict[str, Any] = {"transport": "modbus_rtu", "serial_port": server.line.path} | _PLAIN
        await server.open()
    else:
        assert isinstance(first, ModbusTcpBus)
        host, port = (HOST, 0) if free else (first.host, first.port)
        is_rtu = isinstance(first, ModbusRtuTcpBus)
        server = ModbusServer(devices, host, None if is_rtu else port, None, port if is_rtu else None, called)
        await server.open()
        section = {"transport": "modbus_rtu_tcp" if is_rtu else "modbus_tcp", "host": host}
        section["port"] = server.rtu_port if is_rtu else server.port
    serving.servers.append(server)
    return {name: dict(section) for name in names}


def _close(serving: _Serving, servers: Iterable[asyncio.Server]) -> None:
    serving.close_servers()
    for server in servers:
        server.close()
    for hub in serving.hubs.values():
        for client in tuple(hub.clients):
            client.close()
    if serving.controller is not None:
        with contextlib.suppress(OSError):
            serving.controller.close()
