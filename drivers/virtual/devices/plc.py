"""Process 1 of the virtual rig: the plant, its PLC's Modbus/TCP server, and the control port.

python -m drivers.virtual.devices.plc [--mode real|scaled|lockstep] [--speed N] [--period S] [--seed N] [--start S]
    [--with EFFECTS.toml] [--host H] [--modbus-port P] [--control-port P] [--link-fd FD] [--truth FILE]
    [--tls-certificate PEM --tls-key PEM --tls-ca PEM] [--rtu-port P] [--serial]
"""

from __future__ import annotations

import argparse
import asyncio
import socket
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.virtual.devices import link
from drivers.virtual.devices.control import ControlConnection, ControlledRig
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


class Plc(ControlledRig):
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
        super().__init__(mode, period_s, period_s / speed if mode == "scaled" else period_s)
        self.registers = Registers()
        own = plant is None
        self.plant = plant or Plant(seed=seed, period_s=period_s, effects=effects, start_s=start_s)
        self._instruments = Instruments(seed, period_s, effects, unit)
        self.link: link.LinkSender | None = None
        self.truth: TruthLog | None = None
        self.missed_records = 0
        if own:  # compile or load the physics before the ports open
            Plant(seed=seed, period_s=period_s).step(0.0, 0.0, 0.0)
        self.registers.publish(self._instruments.read(self.plant), 0)

    @property
    def time_s(self) -> float:
        """Rig time, s."""
        return self.plant.time_s

    def cycle(self) -> None:
        """Advance rig time by one period."""
        registers, plant = self.registers, self.plant
        try:
            plant.step(registers.heater_W, registers.pump_fraction, registers.fan_fraction)
        except FmuPlantError as error:
            self.fail(error)
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

    def restart(self) -> None:
        """Lose the registers of the PLC; its plant goes on."""
        self.registers.restart()
        self.registers.on_write()


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
    plc.servers.append(modbus)
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
    plc.close_servers()
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
