"""Starts, watches and ends the two processes of the virtual rig.

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
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from drivers.virtual.plant.effects import load_effects

Mode = Literal["real", "scaled", "lockstep"]

START_TIMEOUT_S = 120.0
"""The first start on a machine compiles the physics."""
END_TIMEOUT_S = 3.0
_TLS = ("--tls-certificate", "--tls-key", "--tls-ca")
_PORTS = ("modbus_port", "can_port", "control_port", "rtu_port", "serial_port")


class VirtualRigError(Exception):
    """The virtual rig cannot be started, or ended by itself."""


class PortInUseError(VirtualRigError, OSError):
    """A port of the virtual rig cannot be opened."""


class _Child:
    """One process of the rig and what it says on stdout."""

    def __init__(self, name: str, process: asyncio.subprocess.Process) -> None:
        self.name, self.process = name, process
        self.last: dict[str, Any] = {}

    async def read_line(self) -> dict[str, Any] | None:
        """Next JSON line; None at the end of the stream."""
        assert self.process.stdout is not None
        while line := await self.process.stdout.readline():
            with contextlib.suppress(json.JSONDecodeError):
                self.last = json.loads(line)
                return self.last
        return None

    async def until_ready(self) -> dict[str, Any]:
        """The readiness line, or an error that says why there is none."""
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
        """End of stdin asks; SIGTERM and SIGKILL insist."""
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
    """A running virtual rig. Ends with `stop`, at the end of `async with`, and whenever this process dies."""

    def __init__(self, host: str, mode: Mode, period_s: float, children: list[_Child], ports: dict[str, Any]) -> None:
        self.host, self.mode, self.period_s = host, mode, period_s
        self.modbus_port = ports["modbus_port"]
        self.can_port = ports["can_port"]
        self.control_port = ports["control_port"]
        self.rtu_port: int | None = ports.get("rtu_port")
        self.serial_port: str | None = ports.get("serial_port")
        self.failure: str | None = None
        """Why the rig ended, where nobody here asked it to."""
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
        """Both processes are alive, as far as has been noticed."""
        return not self._ended.is_set()

    async def wait(self) -> str | None:
        """Until the rig ends; returns `failure` (None after `stop` or a `quit` on the control port)."""
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
        """Follow both processes to their end. The first to go takes the other with it; then judge who is to blame."""
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


async def start_virtual_rig(
    *,
    seed: int = 0,
    mode: Mode = "real",
    speed: float = 1.0,
    period_s: float = 1.0,
    modbus_port: int = 0,
    can_port: int = 0,
    control_port: int = 0,
    rtu_port: int | None = None,
    serial: bool = False,
    effects: Path | None = None,
    host: str = "127.0.0.1",
    unit: int | None = None,
    truth: Path | None = None,
    tls: tuple[Path, Path, Path] | None = None,
    start_s: float = 0.0,
) -> VirtualRig:
    """Start plant and PLC in one process, thermocouple module and CAN bus in another; return when both serve.

    Ports of 0 are chosen by the system. `unit` is the specimen: the same one has the same sensors' offsets, whatever
    the seed; by default another one for every seed. `start_s` is its clock at the start: room and effects are as then,
    the rig itself is cold. What is true is kept in the file `truth` (see `devices.truth`). With `tls`, files of
    certificate, key and certificate authority, Modbus is served over TLS to clients that have a certificate of that
    authority. With `rtu_port` it is served in RTU frames over TCP as well, with `serial` on a pseudo-terminal.
    Raises `PortInUseError`, `EffectFileError`, `VirtualRigError`, and `ValueError` for arguments that make no rig.
    """
    if mode not in ("real", "scaled", "lockstep"):
        raise ValueError(f"mode is {mode!r}; use real, scaled or lockstep.")
    if not (math.isfinite(period_s) and 0.02 <= period_s <= 10.0):
        raise ValueError(f"period_s is {period_s}; give 0.02 to 10 s.")
    if not (math.isfinite(speed) and speed > 0.0):
        raise ValueError(f"speed is {speed}; give a factor above 0.")
    if not (math.isfinite(start_s) and start_s >= 0.0):
        raise ValueError(f"start_s is {start_s}; give 0 s or more.")
    asked = {"modbus_port": modbus_port, "can_port": can_port, "control_port": control_port, "rtu_port": rtu_port or 0}
    for name, port in asked.items():
        if not 0 <= port <= 65535:
            raise ValueError(f"{name} is {port}; give 0 (any free port) to 65535.")
    if effects is not None:
        load_effects(effects)
    common = ["--seed", str(seed), "--host", host]
    if effects is not None:
        common += ["--with", str(effects)]
    if unit is not None:
        common += ["--unit", str(unit)]
    near, far = socket.socketpair()
    children: list[_Child] = []
    try:
        with near, far:
            plc = ["--mode", mode, "--speed", repr(speed), "--period", repr(period_s)]
            plc += ["--modbus-port", str(modbus_port), "--control-port", str(control_port)]
            if truth is not None:
                plc += ["--truth", str(truth)]
            if tls is not None:
                plc += [word for name, path in zip(_TLS, tls, strict=True) for word in (name, str(path))]
            plc += ["--start", repr(start_s)]
            if rtu_port is not None:
                plc += ["--rtu-port", str(rtu_port)]
            if serial:
                plc.append("--serial")
            children.append(await _spawn("plc", [*common, *plc], near))
            module = ["--port", str(can_port), "--epoch", repr(time.time())]
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
    return VirtualRig(host, mode, period_s, children, ports)


async def _spawn(name: str, arguments: list[str], link: socket.socket) -> _Child:
    """One process of the rig, out of reach of the terminal's Ctrl-C: the parent decides how it ends."""
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
    return _Child(name, process)


def serve(*, say: Callable[[str], None] = print, **options: Any) -> int:
    """Run a virtual rig until Ctrl-C or SIGTERM. Takes `start_virtual_rig`'s options; returns an exit code.

    Start-up errors propagate; a rig that dies returns 1 after a sentence.
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
