"""Process 1 of the virtual rig: the plant, its PLC's Modbus/TCP server, and the control port.

python -m drivers.virtual.devices.plc [--mode real|scaled|lockstep] [--speed N] [--period S] [--seed N] [--start S]
    [--with EFFECTS.toml] [--host H] [--modbus-port P] [--control-port P] [--link-fd FD] [--truth FILE]
    [--tls-certificate PEM --tls-key PEM --tls-ca PEM] [--rtu-port P] [--serial]
"""

from __future__ import annotations

import argparse
import asyncio
import math
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.virtual.devices import link
from drivers.virtual.devices.control import ControlConnection
from drivers.virtual.devices.modbus_protocol import DEVICE_ID
from drivers.virtual.devices.modbus_server import ModbusServer, tls_context
from drivers.virtual.devices.registers import Registers
from drivers.virtual.devices.supervision import end_with_parent, listen, port_of, say
from drivers.virtual.devices.truth import TruthLog
from drivers.virtual.fmu import FmuPlant, FmuPlantError
from drivers.virtual.plant import Instruments, Plant, PlantEffect, SimulatedPlant, load_effects

if TYPE_CHECKING:
    from drivers.virtual.devices.pymodbus_server import PymodbusServer

MODES = ("real", "scaled", "lockstep")
SERVERS = ("own", "pymodbus")
LONGEST_REBOOT_S = 600.0
LARGEST_BACKLOG_S = 5.0
"""Wall-clock seconds that the plant catches up with after a stall of the host; older time is lost."""


class Plc:
    """PLC with its plant. It owns rig time: interlocks, plant, read-backs and registers advance once a period."""

    def __init__(
        self,
        mode: str,
        period_s: float,
        speed: float,
        seed: int,
        effects: tuple[PlantEffect, ...],
        unit: int | None = None,
        start_s: float = 0.0,
        plant: SimulatedPlant | None = None,
    ) -> None:
        self.mode, self.period_s = mode, period_s
        self._wall_period_s = period_s / speed if mode == "scaled" else period_s
        self.registers = Registers()
        own = plant is None
        self.plant = plant or Plant(seed=seed, period_s=period_s, effects=effects, start_s=start_s)
        self._instruments = Instruments(seed, period_s, effects, unit)
        self.stop = asyncio.Event()
        self.controller: ControlConnection | None = None
        self.link: link.LinkSender | None = None
        self.truth: TruthLog | None = None
        self.server: ModbusServer | PymodbusServer | None = None
        self.missed_records = 0
        self.ended_because = "stopped"
        self.failed = False
        self._timer: asyncio.TimerHandle | None = None
        self._opening: asyncio.Task[None] | None = None
        self._due = 0.0
        if own:  # compile or load the physics before the ports open
            Plant(seed=seed, period_s=period_s).step(0.0, 0.0, 0.0)
        self.registers.publish(self._instruments.read(self.plant), 0)

    def cycle(self) -> None:
        """Advance rig time by one period."""
        registers, plant = self.registers, self.plant
        try:
            plant.step(registers.heater_W, registers.pump_fraction, registers.fan_fraction)
        except FmuPlantError as error:
            if not self.failed:
                print(f"hil rig: {error}; the rig ends", file=sys.stderr)
            self.failed = True
            self.hold()
            self.stop.set()
            return
        # Temperatures leave first: the other process works while this one packs its registers.
        sender = self.link
        if sender is not None:
            if sender.ready:
                sender.transport.write(link.pack(plant.time_s, plant.junction.tolist()))
            else:
                self.missed_records += 1
        registers.supervise(plant.time_s, plant.heater_water_C)
        registers.publish(self._instruments.read(plant), plant.steps)
        if self.truth is not None:
            self.truth.note(registers, period=True)

    def keep_truth(self, path: Path) -> None:
        """Write what is true to a file from now on."""
        self.truth = truth = TruthLog(path, self.plant)
        self.registers.on_write = lambda: truth.note(self.registers, period=False)

    # Time by itself: real and scaled modes, and lockstep after its client has gone.

    def run_free(self) -> None:
        """Start advancing with the clock."""
        if self._timer is None:
            loop = asyncio.get_running_loop()
            self._due = loop.time() + self._wall_period_s
            self._timer = loop.call_at(self._due, self._tick)

    def hold(self) -> None:
        """Stop advancing by itself."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _tick(self) -> None:
        self.cycle()
        loop = asyncio.get_running_loop()
        if self.failed:
            return
        self._due = max(self._due + self._wall_period_s, loop.time() - LARGEST_BACKLOG_S)
        self._timer = loop.call_at(self._due, self._tick)

    # Commands of the control port.

    def greeting(self) -> str:
        """Return the first line to a control client."""
        return f"virtual-rig 1 mode={self.mode} period={self.period_s!r} t={self.plant.time_s:.3f}\n"

    def grant(self) -> str:
        """Run one granted period; return the answer to the client."""
        if self.mode != "lockstep":
            return f"error the rig runs in {self.mode} time; steps are granted in lockstep only.\n"
        self.cycle()
        if self.failed:
            return "error the plant has failed; the rig ends.\n"
        return f"t {self.plant.time_s:.3f}\n"

    def congested(self) -> bool:
        """Return True in lockstep while steps must wait for the module, so that no frame is lost."""
        return self.mode == "lockstep" and self.link is not None and not self.link.ready

    def on_link_lost(self) -> None:
        """End the rig: the thermocouple module is gone."""
        if not self.stop.is_set():
            self.ended_because = "lost the thermocouple module"
            self.stop.set()

    def on_link_ready(self) -> None:
        """Continue the client's commands: the module caught up."""
        if self.controller is not None:
            self.controller.proceed()

    def on_controller(self, connected: bool) -> None:
        """Hold the time in lockstep while a client grants it; let it run without one, so that the watchdog can trip."""
        if self.mode == "lockstep":
            if connected:
                self.hold()
            elif not self.stop.is_set():
                self.run_free()

    def reboot(self, seconds: str) -> str:
        """Cut the PLC's power for `seconds` (text, s); return the answer to the client."""
        try:
            down_s = float(seconds)
        except ValueError:
            down_s = math.nan
        if not 0.0 <= down_s <= LONGEST_REBOOT_S:
            return f"error reboot takes 0 to {LONGEST_REBOOT_S:g} seconds.\n"
        self.registers.restart()
        self.registers.on_write()
        if self.server is not None:
            self.server.close()
            asyncio.get_running_loop().call_later(down_s, self._serve_again)
        return "ok\n"

    def _serve_again(self) -> None:
        if self.server is not None and not self.stop.is_set():
            self._opening = asyncio.get_running_loop().create_task(self.server.open(), name="reboot")

    def quit(self) -> None:
        """End the process after what is being written."""
        self.ended_because = "quit"
        asyncio.get_running_loop().call_later(0.02, self.stop.set)


async def run(arguments: argparse.Namespace) -> int:
    """Serve until told to stop."""
    effects = load_effects(arguments.effects) if arguments.effects else ()
    plant = None
    if arguments.fmu is not None:
        names = dict(pair.split("=", 1) for pair in arguments.fmu_variable)
        try:
            plant = FmuPlant(
                arguments.fmu, names, seed=arguments.seed, period_s=arguments.period, start_s=arguments.start
            )
        except FmuPlantError as error:
            print(f"hil rig: {error}", file=sys.stderr)
            return 1
    plc = Plc(
        arguments.mode,
        arguments.period,
        arguments.speed,
        arguments.seed,
        effects,
        arguments.unit,
        arguments.start,
        plant,
    )
    if arguments.truth is not None:
        plc.keep_truth(arguments.truth)
    tls = None
    if arguments.tls_certificate is not None:
        tls = tls_context(arguments.tls_certificate, arguments.tls_key, arguments.tls_ca)
    where = (arguments.host, arguments.modbus_port, tls, arguments.rtu_port)
    modbus: ModbusServer | PymodbusServer
    if arguments.server == "pymodbus":
        from drivers.virtual.devices.pymodbus_server import PymodbusServer

        modbus = PymodbusServer(plc.registers, *where)
    else:
        modbus = ModbusServer({DEVICE_ID: plc.registers}, *where)
    plc.server = modbus
    if arguments.serial:
        modbus.open_line()
    await modbus.open()
    control = await listen(lambda: ControlConnection(plc), arguments.host, arguments.control_port, "control")
    loop = asyncio.get_running_loop()
    if arguments.link_fd is not None:
        wire = socket.socket(fileno=arguments.link_fd)
        _, plc.link = await loop.create_connection(
            lambda: link.LinkSender(plc.on_link_ready, plc.on_link_lost), sock=wire
        )
    end_with_parent(plc.stop)
    if plc.mode != "lockstep":
        plc.run_free()
    further = {} if modbus.rtu_port is None else {"rtu_port": modbus.rtu_port}
    line = {} if modbus.line is None else {"serial_port": modbus.line.path}
    say(event="ready", modbus_port=modbus.port, control_port=port_of(control), **further, **line)
    await plc.stop.wait()
    plc.hold()
    modbus.close()
    if modbus.line is not None:
        modbus.line.close()
    control.close()
    if plc.controller is not None:
        plc.controller.close()
    if plc.link is not None:
        plc.link.transport.abort()
    await asyncio.sleep(0)
    say(event="ended", reason=plc.ended_because, t=plc.plant.time_s, missed_records=plc.missed_records)
    return int(plc.failed)


def main() -> int:
    """Run the process by its command line; return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m drivers.virtual.devices.plc")
    parser.add_argument("--mode", choices=MODES, default="real")
    parser.add_argument("--speed", type=float, default=1.0, help="how many times faster, in scaled mode")
    parser.add_argument("--period", type=float, default=1.0, help="plant period in s of rig time")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--start", type=float, default=0.0, help="rig time in s at which it is switched on, cold")
    parser.add_argument("--unit", type=int, help="specimen whose sensors' offsets these are; default: the seed's")
    parser.add_argument("--with", dest="effects", type=Path, help="file of effects")
    parser.add_argument("--fmu", type=Path, help="FMU in the place of the plant")
    parser.add_argument("--fmu-variable", action="append", default=[], metavar="SIGNAL=VARIABLE")
    parser.add_argument("--truth", type=Path, help="record the true state in this file")
    parser.add_argument("--tls-certificate", type=Path, help="serve Modbus over TLS with this certificate (PEM) ...")
    parser.add_argument("--tls-key", type=Path, help="... and key, ...")
    parser.add_argument("--tls-ca", type=Path, help="... to clients with a certificate of this authority")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--modbus-port", type=int, default=0)
    parser.add_argument("--server", choices=SERVERS, default="own", help="whose Modbus server it is")
    parser.add_argument("--rtu-port", type=int, help="serve RTU over TCP on this port, too")
    parser.add_argument("--serial", action="store_true", help="serve RTU on a pseudo-terminal, too")
    parser.add_argument("--control-port", type=int, default=0)
    parser.add_argument("--link-fd", type=int, help="inherited socket to the thermocouple process")
    return asyncio.run(run(parser.parse_args()))


if __name__ == "__main__":
    sys.exit(main())
