"""Control port of the virtual rig: text lines that grant time to the plant in lockstep, or end the rig.

Server on connect: `virtual-rig 1 mode=lockstep period=1.0 t=0.000`. Client: `step` -> `t 1.000` after the plant moved
one period, or `error ...`; `reboot 0.5` -> `ok`, and the PLC loses its memory and does not answer for that many seconds
(its plant goes on); `quit` -> `bye`. One client at a time.
"""

import asyncio
from typing import Protocol

_LONGEST_LINE = 1024


class ControlledRig(Protocol):
    """Interface of the PLC for the control port."""

    controller: "ControlConnection | None"

    def greeting(self) -> str: ...

    def grant(self) -> str: ...

    def congested(self) -> bool: ...

    def on_controller(self, connected: bool) -> None: ...

    def reboot(self, seconds: str) -> str: ...

    def quit(self) -> None: ...


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
