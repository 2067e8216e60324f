"""Start of a rig that is served as its rig file describes it."""

from __future__ import annotations

import asyncio
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from drivers.rig_file import CanBus, ModbusRtuBus, ModbusTcpBus, ModbusTlsBus, Rig, addresses, is_own, load_rig, located
from drivers.signals import ConfigurationError
from drivers.virtual import (
    PortInUseError,
    RunningRig,
    VirtualRigError,
    all_ready,
    spawn,
    stop_on_signals,
    until_stopped,
)
from hil.served_rig.served_file import is_served_copy, write_served_file

MOST_SPEED = 100.0
INVERSE_CRIME = (
    "A twin that predicts itself is an inverse crime: it tries wiring, interlocks, alarms and test plans, and is no "
    "evidence for calibration or diagnosis."
)


class ServedRigError(ConfigurationError):
    """Error of a rig file that cannot be served; the message is one sentence with the remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServedRigOptions:
    """Options of a served rig.

    Attributes
    ----------
    twin
        Twin behind the devices; None serves constant values, and echoes set-points to their read-backs.
    mode
        Real time, `speed` times as fast, or granted step by step on the control port.
    speed
        Factor to real time in modes real and scaled, at most 100 as `time_scale` of a rig file.
    seed
        Seed of the noise.
    control_port
        0 takes a free one.
    free_ports
        Serve on free ports; False serves at the addresses of the rig file, which must be of this machine.
    """

    twin: Path | None = None
    mode: Literal["real", "scaled", "lockstep"] = "real"
    speed: float = 1.0
    seed: int = 0
    control_port: int = 0
    free_ports: bool = True

    def __post_init__(self) -> None:
        if not 0.0 < self.speed <= MOST_SPEED:
            raise ValueError(f"speed is {self.speed:g}; give a factor above 0, at most {MOST_SPEED:g}.")
        if not 0 <= self.control_port <= 65535:
            raise ValueError(f"control_port is {self.control_port}; give 0 (any free port) to 65535.")

    def arguments(self, rig: Path) -> list[str]:
        """Return the command line of the process."""
        words = [str(rig), "--mode", self.mode, "--speed", repr(self.speed), "--seed", str(self.seed)]
        words += ["--control-port", str(self.control_port)]
        if self.twin is not None:
            words += ["--twin", str(self.twin)]
        return words if self.free_ports else [*words, "--own-addresses"]


class ServedRig(RunningRig):
    """Running served rig.

    Attributes
    ----------
    sections
        Keys of each bus that differ from the rig file, by its name.
    control_port
        Port that grants steps in lockstep.
    twin
        Name of the twin behind the devices, or None.
    constant
        Values of the points that nothing drives, by name, in their units.
    """

    def __init__(self, child: Any, ready: dict[str, Any]) -> None:
        super().__init__([child])
        self.sections: dict[str, dict[str, Any]] = ready["sections"]
        self.control_port: int = ready["control_port"]
        self.twin: str | None = ready["twin"]
        self.constant: dict[str, float] = ready["constant"]


async def start_served_rig(file: Path, options: ServedRigOptions) -> ServedRig:
    """Start the process that serves a rig file; return when it serves.

    Raises
    ------
    ServedRigError
        The file, its twin or its DBC files cannot be served.
    PortInUseError, VirtualRigError
        The process cannot be started.
    """
    child = await spawn("served rig", "hil.served_rig", options.arguments(file))
    try:
        (ready,) = await all_ready([child])
        if ready["event"] == "refused":
            raise ServedRigError(ready["message"])
    except BaseException:
        await child.end()
        raise
    return ServedRig(child, ready)


def require_own_addresses(rig: Rig, file: Path) -> None:
    """Raise RigFileError where a bus cannot be served at the rig file's address; may resolve host names."""
    mistakes = []
    for name, bus in rig.bus.items():
        why = None
        if isinstance(bus, ModbusTlsBus):
            why = "wants TLS, which a served rig does not speak"
        elif isinstance(bus, ModbusRtuBus):
            why = f"is at {bus.serial_port}, and a served line is a pseudo-terminal with a name of its own"
        elif isinstance(bus, CanBus) and bus.transport != "socketcand":
            why = f"is {bus.place}, and CAN is served by socketcand"
        elif isinstance(bus, ModbusTcpBus | CanBus) and not all(map(is_own, addresses(bus.host))):
            why = f"is at {bus.host}:{bus.port}, which is not this machine"
        if why is not None:
            remedy = "add --out served.toml, which serves it on a free port and writes the rig file that points there"
            mistakes.append((("bus", name, "transport"), f"bus {name} {why}; {remedy}"))
    if mistakes:
        raise located(file, mistakes)


def serve(file: Path, options: ServedRigOptions, out: Path | None, *, say: Callable[[str], None] = print) -> int:
    """Serve a rig file until Ctrl-C or SIGTERM; return an exit code.

    Parameters
    ----------
    file
        Rig file.
    options
        Twin, time and ports.
    out
        Rig file to write, which points to the served devices; None serves at the file's own addresses.
    say
        Gets lines for the operator.

    Raises
    ------
    ServedRigError
        The file cannot be served, or `out` is a file that is no served copy.
    ConfigurationError
        The rig file has mistakes, or addresses that are not of this machine.
    VirtualRigError
        The process cannot be started.
    """
    rig = load_rig(file)
    if out is None:
        require_own_addresses(rig, file)
    elif out.exists() and (not out.is_file() or not is_served_copy(out)):
        raise ServedRigError(f"{out}: is there already and no served copy; give another name with --out")
    return asyncio.run(_serve(rig, file, options, out, say))


async def _serve(rig: Rig, file: Path, options: ServedRigOptions, out: Path | None, say: Callable[[str], None]) -> int:
    stop = stop_on_signals()
    try:
        started = await start_served_rig(file, options)
    except PortInUseError as error:
        remedy = f"{error.strerror} Or add --out served.toml, which takes free ports."
        raise VirtualRigError(f"{file}: {remedy}") from None
    async with started as served:
        if out is not None:
            try:
                write_served_file(file, served.sections, out, options.speed)
            except OSError as error:
                raise ServedRigError(
                    f"{out}: cannot be written ({error.strerror or error}); give another path with --out"
                ) from None
        for line in _about(rig, file, options, served):
            say(line)
        path = shlex.quote(str(file if out is None else out))
        run = f"hil run LOAD.csv --rig {path}{_granted(options, served)}"
        say(f"  In a second terminal: {run if rig.setpoints else f'hil check {path} --online'}")
        say(f"  {options.mode} time, a period of {rig.period_s:g} s; Ctrl-C ends it.")
        return await until_stopped(served, stop, say)


def _granted(options: ServedRigOptions, served: ServedRig) -> str:
    return f" --control 127.0.0.1:{served.control_port}" if options.mode == "lockstep" else ""


def _about(rig: Rig, file: Path, options: ServedRigOptions, served: ServedRig) -> list[str]:
    """Return lines about the addresses and the plant."""
    lines = [f"{rig.name}, simulated as {file} describes it; no hardware is touched"]
    for name, section in served.sections.items():
        bus, keys = rig.bus[name], dict(section)
        where = keys.get("serial_port") or f"{keys['host']}:{keys['port']}"
        device = f"CAN bus {keys['channel']}" if isinstance(bus, CanBus) else f"device {bus.device_id}"
        points = sum(point.bus == name for point in rig.point)
        lines.append(f"  bus {name}: {keys['transport']} {where}, {device}, {points} points")
    if served.twin is None:
        lines.append("  No twin: set-points appear at their read-backs, all other values rest.")
    else:
        lines += [f"  Plant: twin {served.twin} ({options.twin})", f"  {INVERSE_CRIME}"]
    if served.constant:
        at_rest = ", ".join(f"{name} {value:.4g}" for name, value in served.constant.items() if name not in _own(rig))
        lines += [f"  At rest: {at_rest}"] if at_rest else []
    return lines


def _own(rig: Rig) -> set[str | None]:
    """Return the points that the devices drive themselves: clocks, counter, state of the watchdog."""
    beat = rig.heartbeat
    named = {None} if beat is None else {beat.counter, beat.status}
    return named | {bus.uptime for bus in rig.bus.values()}
