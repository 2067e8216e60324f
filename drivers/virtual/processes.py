"""Processes of a simulated rig: start, readiness, supervision and end."""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import socket
import sys
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any, Self

START_TIMEOUT_S = 120.0
"""Time-out of the start, s: the first start on a machine compiles the physics."""
END_TIMEOUT_S = 3.0


class VirtualRigError(Exception):
    """Error of a virtual rig that cannot be started, or that ended unasked."""


class PortInUseError(VirtualRigError, OSError):
    """Error of a port of the virtual rig that cannot be opened."""


class RigProcess:
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


class RunningRig:
    """Processes of a running rig. It ends with `stop`, at the end of `async with`, and whenever this process dies."""

    def __init__(self, children: Sequence[RigProcess]) -> None:
        self.failure: str | None = None
        """Sentence about the cause, where the rig ended unasked."""
        self._children = children
        self._stopping = False
        self._ended = asyncio.Event()
        self._watcher = asyncio.create_task(self._watch(), name="virtual rig")

    @property
    def pids(self) -> dict[str, int]:
        """Process ids by name."""
        return {child.name: child.process.pid for child in self._children}

    @property
    def running(self) -> bool:
        """True while all processes are alive, as far as has been noticed."""
        return not self._ended.is_set()

    async def wait(self) -> str | None:
        """Wait until the rig ends; return `failure` (None after `stop` or a `quit` on the control port)."""
        await self._ended.wait()
        return self.failure

    async def stop(self) -> None:
        """End the processes and wait for them; harmless when repeated."""
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
        """Follow the processes to their end; when one ends, end the others and note which of them failed."""
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


async def spawn(name: str, module: str, arguments: Sequence[str], link: socket.socket | None = None) -> RigProcess:
    """Start one process of a rig, out of reach of the terminal's Ctrl-C: the parent decides how it ends.

    Parameters
    ----------
    name
        Name in messages.
    module
        Module that runs as the process.
    arguments
        Its command line; `link` is added as `--link-fd`.
    link
        Socket that the process inherits.
    """
    inherited = () if link is None else (link.fileno(),)
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        module,
        *arguments,
        *(word for number in inherited for word in ("--link-fd", str(number))),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        pass_fds=inherited,
        start_new_session=True,
    )
    return RigProcess(name, process)


async def all_ready(children: Sequence[RigProcess]) -> list[dict[str, Any]]:
    """Return the readiness line of each process.

    Raises
    ------
    PortInUseError
        A port cannot be opened.
    VirtualRigError
        A process ended, or was not ready in time.
    """
    try:
        async with asyncio.timeout(START_TIMEOUT_S):
            # The first error wins, not the first process: the PLC also ends when the module could not start.
            said = await asyncio.gather(*(child.until_ready() for child in children), return_exceptions=True)
    except TimeoutError as error:
        raise VirtualRigError(f"The virtual rig was not ready within {START_TIMEOUT_S:g} s; try again.") from error
    errors = [item for item in said if isinstance(item, BaseException)]
    if errors:
        raise next((error for error in errors if isinstance(error, PortInUseError)), errors[0])
    return [line for line in said if isinstance(line, dict)]


def stop_on_signals() -> asyncio.Event:
    """Return an event that Ctrl-C and SIGTERM set, from now on."""
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    return stop


async def until_stopped(rig: RunningRig, stop: asyncio.Event, say: Callable[[str], None]) -> int:
    """Wait for `stop` or the end of `rig`; return an exit code, and `say` why it ended unasked."""
    waits = [asyncio.create_task(stop.wait()), asyncio.create_task(rig.wait())]
    await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    for wait in waits:
        wait.cancel()
    await asyncio.gather(*waits, return_exceptions=True)
    if rig.failure:
        say(rig.failure)
        return 1
    return 0
