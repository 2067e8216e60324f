"""Process of a served rig: its ports, its time and its end.

Ports of the rig file are served as they are, or on free ones; serial lines become pseudo-terminals, and CAN of any kind
becomes socketcand. The readiness line on standard output names the address of each bus.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import sys
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
    ModbusServer,
    end_with_parent,
    frame_text,
    listen,
    port_of,
    say,
)

HOST = "127.0.0.1"
LARGEST_BACKLOG_S = 5.0
"""Wall-clock seconds that the rig catches up with after a stall of the host; older time is lost."""
LONGEST_REBOOT_S = 600.0
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


class _Serving:
    """Time of a served rig, and its control port (`devices.control`)."""

    def __init__(self, rig: DescribedRig, options: ServeOptions, epoch_s: float) -> None:
        self.rig, self._options, self._epoch_s = rig, options, epoch_s
        self.stop = asyncio.Event()
        self.controller: ControlConnection | None = None
        self.servers: list[ModbusServer] = []
        self.hubs: dict[str, CanHub] = {}
        self.ended_because = "stopped"
        self.failed = False
        self._timer: asyncio.TimerHandle | None = None
        self._opening: set[asyncio.Task[None]] = set()
        self._due = 0.0

    # Time by itself: real and scaled modes, and lockstep after its client has gone.

    def run_free(self) -> None:
        """Start advancing with the clock."""
        if self._timer is None:
            loop = asyncio.get_running_loop()
            self._due = loop.time() + self._wall_step_s
            self._timer = loop.call_at(self._due, self._tick)

    def hold(self) -> None:
        """Stop advancing by itself."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    @property
    def _wall_step_s(self) -> float:
        return self.rig.step_s / self._options.speed

    def _advanced(self, steps: int) -> bool:
        """Advance by some steps; False where the plant failed, which ends the rig."""
        try:
            for _ in range(steps):
                self.rig.step()
        except DriverError as error:
            print(f"hil rig: {error}; the rig ends", file=sys.stderr)
            self.failed = True
            self.stop.set()
        return not self.failed

    def _tick(self) -> None:
        loop = asyncio.get_running_loop()
        if not self._advanced(1):
            return
        self._due = max(self._due + self._wall_step_s, loop.time() - LARGEST_BACKLOG_S)
        for name in self.hubs:
            self._send(name)
            self._repeat(name)
        self._timer = loop.call_at(self._due, self._tick)

    def _repeat(self, name: str) -> None:
        """Send the frames of a bus again within the step, where the DBC gives a shorter cycle time."""
        fastest_s = self.rig.encoders[name].fastest_s
        if not math.isfinite(fastest_s) or fastest_s >= self.rig.step_s:
            return
        times = min(math.ceil(self.rig.step_s / fastest_s), _MOST_REPEATS)
        for k in range(1, times):
            part = k / times
            asyncio.get_running_loop().call_later(part * self._wall_step_s, self._send, name, part * self.rig.step_s)

    def _send(self, name: str, later_s: float = 0.0) -> None:
        hub = self.hubs[name]
        if not hub.listeners:
            return
        stamp = self._epoch_s + self.rig.time_s + later_s
        for frame in self.rig.frames(name):
            identifier = f"{frame.identifier:08X}" if frame.extended else f"{frame.identifier:03X}"
            hub.publish(frame_text(identifier, stamp, frame.data), 1)

    # Commands of the control port.

    def greeting(self) -> str:
        """Return the first line to a control client."""
        rig = self.rig
        return f"virtual-rig 1 mode={self._options.mode} period={rig.rig.period_s!r} t={rig.time_s:.3f}\n"

    def grant(self) -> str:
        """Run one granted period; return the answer to the client."""
        if self._options.mode != "lockstep":
            return f"error the rig runs in {self._options.mode} time; steps are granted in lockstep only.\n"
        if not self._advanced(self.rig.steps_of_a_period):
            return "error the plant has failed; the rig ends.\n"
        for name in self.hubs:
            self._send(name)
        return f"t {self.rig.time_s:.3f}\n"

    def congested(self) -> bool:
        """Return False: frames are encoded before a step is answered."""
        return False

    def on_controller(self, connected: bool) -> None:
        """Hold the time in lockstep while a client grants it; let it run without one, so that the watchdog can trip."""
        if self._options.mode == "lockstep":
            if connected:
                self.hold()
            elif not self.stop.is_set():
                self.run_free()

    def reboot(self, seconds: str) -> str:
        """Cut the devices' power for `seconds` (text, s); return the answer to the client."""
        try:
            down_s = float(seconds)
        except ValueError:
            down_s = math.nan
        if not 0.0 <= down_s <= LONGEST_REBOOT_S:
            return f"error reboot takes 0 to {LONGEST_REBOOT_S:g} seconds.\n"
        self.rig.restart()
        for server in self.servers:
            server.close()
        asyncio.get_running_loop().call_later(down_s, self._serve_again)
        return "ok\n"

    def _serve_again(self) -> None:
        if self.stop.is_set():
            return
        for server in self.servers:
            task = asyncio.get_running_loop().create_task(server.open(), name="reboot")
            self._opening.add(task)
            task.add_done_callback(self._opening.discard)

    def quit(self) -> None:
        """End the process after what is being written."""
        self.ended_because = "quit"
        asyncio.get_running_loop().call_later(0.02, self.stop.set)


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
        sections |= await _open_wire(serving, rig, names)
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


async def _open_wire(serving: _Serving, rig: Rig, names: list[str]) -> dict[str, dict[str, Any]]:
    """Open the port or line that some buses share; return the address of each as keys of its section."""
    first, free = rig.bus[names[0]], serving._options.free_ports
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
    for modbus in serving.servers:
        modbus.close()
        if modbus.line is not None:
            modbus.line.close()
    for server in servers:
        server.close()
    for hub in serving.hubs.values():
        for client in tuple(hub.clients):
            client.close()
    if serving.controller is not None:
        with contextlib.suppress(OSError):
            serving.controller.close()
