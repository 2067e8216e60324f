"""Start, supervision and end of the virtual rig's two processes.

    rig = await start_virtual_rig(mode="lockstep", seed=7)
    async with rig:
        ...  # talk to rig.modbus_port, rig.can_port, rig.control_port

`serve` is the blocking form for a command line.
"""

import asyncio
import contextlib
import json
import math
import signal
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, get_args

from drivers.virtual.plant import load_effects

Mode = Literal["real", "scaled", "lockstep"]
Server = Literal["own", "pymodbus"]

START_TIMEOUT_S = 120.0
"""Time-out of the start, s: the first start on a machine compiles the physics."""
END_TIMEOUT_S = 3.0
_TLS = ("--tls-certificate", "--tls-key", "--tls-ca")
_PORTS = ("modbus_port", "can_port", "control_port", "rtu_port", "serial_port")


class VirtualRigError(Exception):
    """Error of a virtual rig that cannot be started, or that ended unasked."""


class PortInUseError(VirtualRigError, OSError):
    """Error of a port of the virtual rig that cannot be opened."""


class _RigProcess:
    """Process of the rig and the JSON lines of its standard output."""

    def __init__(self, name: str, process: asyncio.subprocess.Process) -> None:
        self.name, self.process = name, process
        self.last: dict[str, Any] = {}

    async def read_line(self) -> dict[str, Any] | None:
        """Return the next JSON line; None at the end of the stream."""
        assert self.process.stdout is not None
        while line := await self.process.stdout.readline():
            with contextlib.suppress(json.JSONDecodeError):
                self.last = json.loads(line)
                return self.last
        return None

    async def until_ready(self) -> dict[str, Any]:
        """Return the readiness line; raise VirtualRigError or PortInUseError where there is none."""
        line = await self.read_line()
        if line is None:
            code = await self.process.wait()
            raise VirtualRigError(
                f"The virtual rig's process '{self.name}' ended with exit code {code} before it was ready; "
                "its message is on standard error."
            )
        if line["event"] == "error":
            raise PortInUseError(line["errno"], line["message"])
        return line

    async def until_end(self) -> None:
        """Read to the end of stdout and collect the exit code."""
        while await self.read_line() is not None:
            pass
        await self.process.wait()

    async def end(self) -> None:
        """End the process: close its standard input, then send SIGTERM, then SIGKILL."""
        if self.process.stdin is not None:
            self.process.stdin.close()
        for insist in (self.process.terminate, self.process.kill):
            try:
                await asyncio.wait_for(self.process.wait(), END_TIMEOUT_S)
                return
            except TimeoutError:
                with contextlib.suppress(ProcessLookupError):
                    insist()
        await self.process.wait()


class VirtualRig:
    """Running virtual rig. It ends with `stop`, at the end of `async with`, and whenever this process dies."""

    def __init__(
        self, host: str, mode: Mode, period_s: float, children: list[_RigProcess], ports: dict[str, Any]
    ) -> None:
        self.host, self.mode, self.period_s = host, mode, period_s
        self.modbus_port = ports["modbus_port"]
        self.can_port = ports["can_port"]
        self.control_port = ports["control_port"]
        self.rtu_port: int | None = ports.get("rtu_port")
        self.serial_port: str | None = ports.get("serial_port")
        self.failure: str | None = None
        """Sentence about the cause, where the rig ended unasked."""
        self._children = children
        self._stopping = False
        self._ended = asyncio.Event()
        self._watcher = asyncio.create_task(self._watch(), name="virtual rig")

    @property
    def pids(self) -> dict[str, int]:
        """Process ids of `plc` and `thermocouples`."""
        return {child.name: child.process.pid for child in self._children}

    @property
    def running(self) -> bool:
        """True while both processes are alive, as far as has been noticed."""
        return not self._ended.is_set()

    async def wait(self) -> str | None:
        """Wait until the rig ends; return `failure` (None after `stop` or a `quit` on the control port)."""
        await self._ended.wait()
        return self.failure

    async def stop(self) -> None:
        """End both processes and wait for them; harmless when repeated."""
        self._stopping = True
        await asyncio.gather(*(child.end() for child in self._children))
        await self._watcher

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.stop()

    async def _watch(self) -> None:
        """Follow both processes to their end; when one ends, end the other and note which of them failed."""
        follow = [asyncio.create_task(child.until_end()) for child in self._children]
        await asyncio.wait(follow, return_when=asyncio.FIRST_COMPLETED)
        asked = self._stopping
        await asyncio.gather(*(child.end() for child in self._children))
        await asyncio.gather(*follow)
        if not asked and not any(child.last.get("reason") == "quit" for child in self._children):
            blame = max(self._children, key=lambda child: child.process.returncode != 0)
            code = blame.process.returncode or 0
            how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
            self.failure = f"The virtual rig's process '{blame.name}' ended {how}; start the rig again."
        self._ended.set()


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
    children: list[_RigProcess] = []
    try:
        with near, far:
            children.append(await _spawn("plc", [*common, *options.plc_arguments()], near))
            module = ["--port", str(options.can_port), "--epoch", repr(time.time())]
            children.append(await _spawn("thermocouples", [*common, *module], far))
        ports: dict[str, Any] = {}
        async with asyncio.timeout(START_TIMEOUT_S):
            # The first error wins, not the first process: the PLC also ends when the module could not start.
            said = await asyncio.gather(*(child.until_ready() for child in children), return_exceptions=True)
        errors = [item for item in said if isinstance(item, BaseException)]
        if errors:
            raise next((error for error in errors if isinstance(error, PortInUseError)), errors[0])
        for line in said:
            assert isinstance(line, dict)
            ports.update({key: line[key] for key in _PORTS if key in line})
    except TimeoutError as error:
        await asyncio.gather(*(child.end() for child in children))
        raise VirtualRigError(f"The virtual rig was not ready within {START_TIMEOUT_S:g} s; try again.") from error
    except BaseException:
        await asyncio.gather(*(child.end() for child in children))
        raise
    return VirtualRig(options.host, options.mode, options.period_s, children, ports)


async def _spawn(name: str, arguments: list[str], link: socket.socket) -> _RigProcess:
    """Start one process of the rig, out of reach of the terminal's Ctrl-C: the parent decides how it ends."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        f"drivers.virtual.devices.{name}",
        *arguments,
        "--link-fd",
        str(link.fileno()),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        pass_fds=(link.fileno(),),
        start_new_session=True,
    )
    return _RigProcess(name, process)


def serve(*, say: Callable[[str], None] = print, **options: Any) -> int:
    """Run a virtual rig until Ctrl-C or SIGTERM, with the options of `start_virtual_rig`; return an exit code.

    Errors of the start propagate; a rig that dies gives a sentence and exit code 1.
    """
    return asyncio.run(_serve(say, options))


async def _serve(say: Callable[[str], None], options: dict[str, Any]) -> int:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
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
        waits = [asyncio.create_task(stop.wait()), asyncio.create_task(rig.wait())]
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        for wait in waits:
            wait.cancel()
        await asyncio.gather(*waits, return_exceptions=True)
        failure = rig.failure
    if failure:
        say(failure)
        return 1
    return 0
