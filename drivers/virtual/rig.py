"""Options, start and serving of the virtual rig's two processes.

    rig = await start_virtual_rig(mode="lockstep", seed=7)
    async with rig:
        ...  # talk to rig.modbus_port, rig.can_port, rig.control_port

`serve` is the blocking form for a command line.
"""

import asyncio
import math
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

from drivers.virtual.plant import load_effects
from drivers.virtual.processes import RigProcess, RunningRig, all_ready, spawn, stop_on_signals, until_stopped

Mode = Literal["real", "scaled", "lockstep"]
Server = Literal["own", "pymodbus"]

_TLS = ("--tls-certificate", "--tls-key", "--tls-ca")
_PORTS = ("modbus_port", "can_port", "control_port", "rtu_port", "serial_port")


class VirtualRig(RunningRig):
    """Running virtual rig: processes `plc` and `thermocouples`, and their ports."""

    def __init__(
        self, host: str, mode: Mode, period_s: float, children: list[RigProcess], ports: dict[str, Any]
    ) -> None:
        super().__init__(children)
        self.host, self.mode, self.period_s = host, mode, period_s
        self.modbus_port = ports["modbus_port"]
        self.can_port = ports["can_port"]
        self.control_port = ports["control_port"]
        self.rtu_port: int | None = ports.get("rtu_port")
        self.serial_port: str | None = ports.get("serial_port")


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualRigOptions:
    """Options of a virtual rig.

    Attributes
    ----------
    seed
        Seed of noise, offsets and draughts.
    mode
        Real time, `speed` times as fast, or granted step by step on the control port.
    speed
        Times real time, in scaled mode.
    period_s
        Seconds between samples, 0.02 to 10.
    modbus_port, can_port, control_port
        0 takes a free one.
    rtu_port
        Port of a second Modbus server with RTU frames over TCP; None for no such server.
    serial
        True for a third one on a pseudo-terminal.
    effects
        File of effects that no twin knows of.
    fmu
        FMU in the place of the plant (see `drivers.virtual.fmu.FmuPlant`); it takes no `effects`.
    fmu_variables
        Pairs of a signal of the rig and a variable of the FMU, where their names differ.
    host
        Address to listen on.
    unit
        Specimen; the same one has the same sensors' offsets. None takes another one for every seed.
    truth
        File in which the rig records its true state (see `devices.truth`).
    tls
        Files of certificate, key and authority; Modbus is then served over TLS to clients of that authority.
    start_s
        Rig time at the start, s: room and effects are as then, the rig itself is cold.
    server
        The project's own Modbus server, or that of pymodbus.

    Raises
    ------
    ValueError
        An option that makes no rig.
    """

    seed: int = 0
    mode: Mode = "real"
    speed: float = 1.0
    period_s: float = 1.0
    modbus_port: int = 0
    can_port: int = 0
    control_port: int = 0
    rtu_port: int | None = None
    serial: bool = False
    effects: Path | None = None
    fmu: Path | None = None
    fmu_variables: tuple[tuple[str, str], ...] = ()
    host: str = "127.0.0.1"
    unit: int | None = None
    truth: Path | None = None
    tls: tuple[Path, Path, Path] | None = None
    start_s: float = 0.0
    server: Server = "own"

    def __post_init__(self) -> None:
        if self.mode not in get_args(Mode):
            raise ValueError(f"mode is {self.mode!r}; use real, scaled or lockstep.")
        if self.server not in get_args(Server):
            raise ValueError(f"server is {self.server!r}; use own or pymodbus.")
        if not (math.isfinite(self.period_s) and 0.02 <= self.period_s <= 10.0):
            raise ValueError(f"period_s is {self.period_s}; give 0.02 to 10 s.")
        if not (math.isfinite(self.speed) and self.speed > 0.0):
            raise ValueError(f"speed is {self.speed}; give a factor above 0.")
        if not (math.isfinite(self.start_s) and self.start_s >= 0.0):
            raise ValueError(f"start_s is {self.start_s}; give 0 s or more.")
        if self.fmu is not None and self.effects is not None:
            raise ValueError("effects change the built-in plant, which an FMU replaces; leave one of the two out.")
        if self.fmu is None and self.fmu_variables:
            raise ValueError("variables of an FMU are named, but no FMU; give it, too.")
        for name in ("modbus_port", "can_port", "control_port", "rtu_port"):
            port = getattr(self, name) or 0
            if not 0 <= port <= 65535:
                raise ValueError(f"{name} is {port}; give 0 (any free port) to 65535.")

    def common_arguments(self) -> list[str]:
        """Return the command line that both processes of the rig get."""
        words = ["--seed", str(self.seed), "--host", self.host]
        if self.effects is not None:
            words += ["--with", str(self.effects)]
        if self.unit is not None:
            words += ["--unit", str(self.unit)]
        return words

    def plc_arguments(self) -> list[str]:
        """Return the command line of the process with plant and PLC."""
        words = ["--mode", self.mode, "--speed", repr(self.speed), "--period", repr(self.period_s)]
        words += ["--modbus-port", str(self.modbus_port), "--control-port", str(self.control_port)]
        words += ["--start", repr(self.start_s), "--server", self.server]
        if self.fmu is not None:
            words += ["--fmu", str(self.fmu)]
        words += [word for pair in self.fmu_variables for word in ("--fmu-variable", "=".join(pair))]
        if self.truth is not None:
            words += ["--truth", str(self.truth)]
        if self.tls is not None:
            words += [word for name, path in zip(_TLS, self.tls, strict=True) for word in (name, str(path))]
        if self.rtu_port is not None:
            words += ["--rtu-port", str(self.rtu_port)]
        if self.serial:
            words.append("--serial")
        return words


async def start_virtual_rig(options: VirtualRigOptions | None = None, **changes: Any) -> VirtualRig:
    """Start plant and PLC in one process, thermocouple module and CAN bus in another; return when both serve.

    Parameters
    ----------
    options
        Of the rig; by default those of `VirtualRigOptions`.
    changes
        Single options by name, in place of those in `options`.

    Raises
    ------
    PortInUseError, EffectFileError, FmuPlantError, VirtualRigError
        The rig cannot be started; the message says why.
    ValueError
        Options that make no rig.
    """
    options = replace(options or VirtualRigOptions(), **changes)
    if options.effects is not None:
        load_effects(options.effects)
    if options.fmu is not None:
        from drivers.virtual.fmu import fmu_ports

        fmu_ports(options.fmu, dict(options.fmu_variables))
    common = options.common_arguments()
    near, far = socket.socketpair()
    children: list[RigProcess] = []
    try:
        with near, far:
            plc = [*common, *options.plc_arguments()]
            children.append(await spawn("plc", "drivers.virtual.devices.plc", plc, near))
            module = ["--port", str(options.can_port), "--epoch", repr(time.time())]
            node = "drivers.virtual.devices.thermocouples"
            children.append(await spawn("thermocouples", node, [*common, *module], far))
        ports: dict[str, Any] = {}
        for line in await all_ready(children):
            ports.update({key: line[key] for key in _PORTS if key in line})
    except BaseException:
        await asyncio.gather(*(child.end() for child in children))
        raise
    return VirtualRig(options.host, options.mode, options.period_s, children, ports)


def serve(*, say: Callable[[str], None] = print, **options: Any) -> int:
    """Run a virtual rig until Ctrl-C or SIGTERM, with the options of `start_virtual_rig`; return an exit code.

    Errors of the start propagate; a rig that dies gives a sentence and exit code 1.
    """
    return asyncio.run(_serve(say, options))


async def _serve(say: Callable[[str], None], options: dict[str, Any]) -> int:
    stop = stop_on_signals()
    async with await start_virtual_rig(**options) as rig:
        kind = "Modbus/TCP" if options.get("tls") is None else "Modbus/TCP over TLS,"
        say(f"Virtual rig on {rig.host}: {kind} port {rig.modbus_port}, device id 1")
        say(f"  CAN (socketcand, bus vcan0) port {rig.can_port}, control port {rig.control_port}")
        if rig.rtu_port is not None:
            say(f"  Modbus RTU over TCP port {rig.rtu_port}")
        if rig.serial_port is not None:
            say(f"  Modbus RTU on {rig.serial_port}")
        if rig.host not in ("127.0.0.1", "localhost", "::1"):
            what = "Reachable" if options.get("tls") is None else "CAN and control port are reachable"
            say(f"  {what} from other machines, without any password.")
        say(f"  {rig.mode} time, a period of {rig.period_s:g} s; Ctrl-C ends it.")
        return await until_stopped(rig, stop, say)
