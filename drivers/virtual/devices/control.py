"""Control port of the virtual rig: text lines that grant time to the plant in lockstep, or end the rig.

Server on connect: `virtual-rig 1 mode=lockstep period=1.0 t=0.000`. Client: `step` -> `t 1.000` after the plant moved
one period, or `error ...`; `reboot 0.5` -> `ok`, and the PLC loses its memory and does not answer for that many seconds
(its plant goes on); `quit` -> `bye`. One client at a time.
"""

from __future__ import annotations

import asyncio
import math
import sys
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from drivers.virtual.devices.rtu_protocol import PseudoLine

LARGEST_BACKLOG_S = 5.0
"""Wall-clock seconds that a rig catches up with after a stall of the host; older time is lost."""
LONGEST_REBOOT_S = 600.0
_LONGEST_LINE = 1024


class PoweredServer(Protocol):
    """Modbus server that a reboot closes and opens again, with its serial line if it has one."""

    line: PseudoLine | None

    async def open(self) -> None: ...

    def close(self) -> None: ...


class ControlledRig(ABC):
    """Rig behind a control port: time, reboot and end.

    Time runs by itself in modes real and scaled, and in lockstep while no client grants it.

    Parameters
    ----------
    mode
        `real`, `scaled` or `lockstep`.
    period_s
        Period that a client grants, s of rig time.
    tick_s
        Wall-clock seconds between ticks of a rig whose time runs by itself.
    """

    def __init__(self, mode: str, period_s: float, tick_s: float) -> None:
        self.mode, self.period_s = mode, period_s
        self.stop = asyncio.Event()
        self.controller: ControlConnection | None = None
        self.servers: list[PoweredServer] = []
        self.ended_because = "stopped"
        self.failed = False
        self._tick_s = tick_s
        self._due = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._opening: set[asyncio.Task[None]] = set()

    # A rig's own parts.

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Rig time, s."""

    @abstractmethod
    def cycle(self) -> None:
        """Advance rig time by one period; `fail` where the plant cannot."""

    def tick(self) -> None:
        """Advance rig time by one tick of `tick_s`, a period unless a rig has shorter ones."""
        self.cycle()

    @abstractmethod
    def restart(self) -> None:
        """Lose what the devices hold in memory."""

    def congested(self) -> bool:
        """Return True while steps must wait for another process."""
        return False

    # Time by itself.

    def run_free(self) -> None:
        """Start advancing with the clock."""
        if self._timer is None:
            loop = asyncio.get_running_loop()
            self._due = loop.time() + self._tick_s
            self._timer = loop.call_at(self._due, self._on_time)

    def hold(self) -> None:
        """Stop advancing by itself."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _on_time(self) -> None:
        self.tick()
        if self.failed:
            return
        loop = asyncio.get_running_loop()
        self._due = max(self._due + self._tick_s, loop.time() - LARGEST_BACKLOG_S)
        self._timer = loop.call_at(self._due, self._on_time)

    def fail(self, error: Exception) -> None:
        """End the rig because its plant failed."""
        if not self.failed:
            print(f"hil rig: {error}; the rig ends", file=sys.stderr)
        self.failed = True
        self.hold()
        self.stop.set()

    # Commands of the control port.

    def greeting(self) -> str:
        """Return the first line to a control client."""
        return f"virtual-rig 1 mode={self.mode} period={self.period_s!r} t={self.time_s:.3f}\n"

    def grant(self) -> str:
        """Run one granted period; return the answer to the client."""
        if self.mode != "lockstep":
            return f"error the rig runs in {self.mode} time; steps are granted in lockstep only.\n"
        self.cycle()
        if self.failed:
            return "error the plant has failed; the rig ends.\n"
        return f"t {self.time_s:.3f}\n"

    def on_controller(self, connected: bool) -> None:
        """Hold the time in lockstep while a client grants it; let it run without one, so that the watchdog can trip."""
        if self.mode == "lockstep":
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
        self.restart()
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

    def close_servers(self) -> None:
        """Close the Modbus servers and their lines for good."""
        for server in self.servers:
            server.close()
            if server.line is not None:
                server.line.close()

    def quit(self) -> None:
        """End the process after what is being written."""
        self.ended_because = "quit"
        asyncio.get_running_loop().call_later(0.02, self.stop.set)


class ControlConnection(asyncio.Protocol):
    """Connection of one client of the control port."""

    def __init__(self, rig: ControlledRig) -> None:
        self._rig = rig
        self._rest = b""
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet the only client; turn a second one away."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if self._rig.controller is not None:
            transport.write(b"error another client holds the control port; try again when it has gone.\n")
            transport.close()
            return
        self._rig.controller = self
        self._rig.on_controller(True)
        transport.write(self._rig.greeting().encode("ascii"))

    def connection_lost(self, exc: Exception | None) -> None:
        """Release the control port: without a client the rig goes on without grants."""
        if self._rig.controller is self:
            self._rig.controller = None
            self._rig.on_controller(False)

    def close(self) -> None:
        """Drop the client."""
        self._transport.abort()

    def data_received(self, data: bytes) -> None:
        """Execute whole lines."""
        if self._rig.controller is not self:
            return
        self._rest += data
        self.proceed()

    def proceed(self) -> None:
        """Work off the lines received so far; steps wait while the thermocouple module is behind."""
        while b"\n" in self._rest:
            if self._rig.congested():
                self._transport.pause_reading()
                return
            line, self._rest = self._rest.split(b"\n", 1)
            command = line.strip()
            if command == b"step":
                self._transport.write(self._rig.grant().encode("ascii"))
            elif command.startswith(b"reboot "):
                self._transport.write(self._rig.reboot(command[7:].decode("ascii", "replace")).encode("ascii"))
            elif command == b"quit":
                self._transport.write(b"bye\n")
                self._rig.quit()
            elif command:
                self._transport.write(b"error unknown command; send step or quit.\n")
        if len(self._rest) > _LONGEST_LINE:
            self._rest = b""
            self._transport.write(b"error line too long; send step or quit.\n")
        if not self._transport.is_reading() and not self._transport.is_closing():
            self._transport.resume_reading()
