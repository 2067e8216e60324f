"""Engine's half of the guardian: started and told the plan before anything is armed, given a beat while ticks go on."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import select
import socket
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from drivers.bus.steady_time import steady_s
from drivers.rig_file.model import Rig
from drivers.signals.points import LinkError
from hil.guardian.plan import plan_of
from hil.run.outputs.time_to_safe import SAFE_WITHIN_S, SILENCE_S, takes_s

BEAT_EVERY_S = 0.2
TICK_BEATS_AFTER_S = 0.75 * BEAT_EVERY_S
"""A tick gives the beat where the last one is older than this: ahead of the loop's timer, which so stays asleep."""
LOOK_AGAIN_S = 0.02
"""Messages of the guardian are not looked for again within this time, s: far below the silence it acts on."""
FENCE_S = 0.8 * SILENCE_S
"""An engine that has not beaten for so long may have been relieved: it writes no more heat until it knows, s."""
STARTS_WITHIN_S = 10.0
MUTE_AFTER_S = 2.0
"""A guardian that says nothing for so long, while this process was running all the time, is not there, s."""
_PACKAGE = Path(__file__).resolve().parents[2]


class GuardianError(LinkError):
    """The guardian cannot guard this rig; the message says what would not be guarded."""


@dataclass(frozen=True, slots=True)
class Acted:
    """What the guardian has done: why, whether the safe values are read back and the meters agree, and why not."""

    reason: str
    safe: bool
    problem: str
    meters: dict[str, float] = field(default_factory=dict)


class Guard(Protocol):
    """What the engine needs of a guardian."""

    acted: Acted | None

    async def start(self) -> None:
        """Start it and tell it the plan; raises GuardianError."""

    async def probe(self) -> list[str]:
        """Return why wires cannot be reached beside the engine; each is taken over by ending the engine."""

    def watch(self) -> None:
        """Arm it: from now on silence counts."""

    def expect(self, within_s: float) -> None:
        """Beat on by itself for so long; a tick that takes longer than that is silence."""

    def may_heat(self) -> bool:
        """Return whether this engine is sure to be in charge: not silent meanwhile, and the guardian has not acted."""

    def failure(self) -> str | None:
        """Return why the run has to end: the guardian is gone, or has acted."""

    def act(self) -> None:
        """Have it make the rig safe now, beside the engine."""

    async def done(self, *, safe: bool) -> None:
        """End it; one that is not told that the rig is `safe` makes it so as soon as this process is gone."""


class NoGuard:
    """Nobody guards: the rig is this process's own virtual one, or the operator gave the guardian up."""

    acted: Acted | None = None

    async def start(self) -> None:
        """Nothing to start."""

    async def probe(self) -> list[str]:
        """Nothing is unreachable."""
        return []

    def watch(self) -> None:
        """Nothing to arm."""

    def expect(self, within_s: float) -> None:
        """Nobody waits for beats."""

    def may_heat(self) -> bool:
        """Nobody else is in charge."""
        return True

    def failure(self) -> str | None:
        """Nothing can fail."""
        return None

    def act(self) -> None:
        """Nobody to ask."""

    async def done(self, *, safe: bool) -> None:
        """Nothing to end."""


class Guardian:
    """The guardian of one run. `log` is its file; `keep` are descriptors that it holds open as long as it lives.

    The rig's locks are such: nobody else drives the rig before the guardian has made it safe.
    """

    def __init__(self, rig: Rig, log: Path, keep: Sequence[int] = ()) -> None:
        self.acted: Acted | None = None
        self._plan = plan_of(rig)
        self._log = log
        self._keep = tuple(keep)
        self._socket: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""
        self._probed: asyncio.Future[list[str]] | None = None
        self._until = self._beat_s = self._heard_s = self._looked_s = self._mute_s = 0.0
        self._lost: str | None = None
        self._watching = False
        self._sure = True
        self._loop: asyncio.AbstractEventLoop | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._poll = select.poll()

    @property
    def pid(self) -> int | None:
        """Id of the guardian's process, once it is started."""
        return None if self._process is None else self._process.pid

    async def start(self) -> None:
        """Start the process and tell it the plan; raises GuardianError where it does not answer."""
        if self._plan is None:
            return
        self._spawn(self._plan)
        end = steady_s() + STARTS_WITHIN_S
        while self._heard_s == 0.0:
            self._receive()
            if self._lost is not None or steady_s() > end:
                raise GuardianError(f"not armed: the guardian does not start ({self._lost or 'no answer'})")
            await asyncio.sleep(0.005)

    def _spawn(self, plan: dict[str, Any]) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        code = (
            f"import sys; sys.path.insert(0, {str(_PACKAGE)!r}); "
            f"from hil.guardian.process import main; main({theirs.fileno()}, {os.getpid()})"
        )
        try:
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable, "-I", "-S", "-c", code],
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(), *self._keep), cwd="/", start_new_session=True,
                )  # fmt: skip
        except OSError as error:
            ours.close()
            raise GuardianError(f"not armed: the guardian cannot be started ({error})") from error
        self._socket = ours
        ours.sendall(json.dumps(plan | {"log": str(self._log.absolute())}, ensure_ascii=True).encode() + b"\n")
        ours.setblocking(False)
        self._poll.register(ours, select.POLLIN)

    async def probe(self) -> list[str]:
        """Return why wires cannot be reached beside the engine's own connection, a sentence each."""
        if self._socket is None or self._plan is None:
            return []
        self._probed = asyncio.get_running_loop().create_future()
        self._say(b"probe")
        # The guardian waits out the time after connecting in which a device takes no request.
        end = steady_s() + STARTS_WITHIN_S + sum(wire["connect_delay_s"] for wire in self._plan["wires"])
        while not self._probed.done():
            self._receive()
            if self._lost is not None or steady_s() > end:
                raise GuardianError(f"not armed: the guardian is gone ({self._lost or 'no answer'})")
            await asyncio.sleep(0.005)
        wires = self._plan["wires"]
        return [why + _later(wire) for wire, why in zip(wires, self._probed.result(), strict=True) if why]

    def watch(self) -> None:
        """Arm it: from now on silence counts."""
        if self._socket is None:
            return
        self._say(b"watch")
        self._watching = True
        self._beat_s, self._mute_s = steady_s(), 0.0
        self._loop = asyncio.get_running_loop()
        self.expect(STARTS_WITHIN_S)
        self._arm_timer()

    def expect(self, within_s: float) -> None:
        """Beat now and, by the loop, for `within_s` of wall time; a tick that takes longer is silence."""
        if not self._watching:
            return
        now = steady_s()
        self._until = now + within_s
        if now - self._beat_s > TICK_BEATS_AFTER_S:
            self._beat(now)
            self._arm_timer()

    def _arm_timer(self) -> None:
        """Have the loop beat `BEAT_EVERY_S` from now, unless a tick does so before."""
        if self._timer is not None:
            self._timer.cancel()
        assert self._loop is not None
        self._timer = self._loop.call_later(BEAT_EVERY_S, self._beat_between_ticks)

    def _beat_between_ticks(self) -> None:
        self._arm_timer()
        now = steady_s()
        self._receive()
        if now < self._until:
            self._beat(now)

    def _beat(self, now: float) -> None:
        if now - self._beat_s > FENCE_S:
            self._sure = False  # until the guardian says that it has not acted meanwhile
            self._say(b"check")
        self._say(b"beat")
        self._beat_s = now

    def may_heat(self) -> bool:
        """Return whether the guardian is sure to have had beats, and has not acted."""
        if not self._watching:
            return True
        now = steady_s()
        if now - self._beat_s > FENCE_S:
            return False
        if now - self._looked_s > LOOK_AGAIN_S:
            self._receive()
        return self._sure and self.acted is None and self._lost is None

    def failure(self) -> str | None:
        """Return why the run has to end: the guardian has acted, is gone or does not answer."""
        if not self._watching:
            return None
        self._receive()
        if self.acted is not None:
            return f"the guardian has made the rig safe: {self.acted.reason}"
        if self._lost is not None:
            return f"the guardian is gone ({self._lost}); nobody would make the rig safe if this process were killed"
        if self._mute_s > MUTE_AFTER_S:
            return f"the guardian has not answered for {MUTE_AFTER_S:g} s"
        return None

    def act(self) -> None:
        """Have it make the rig safe now, beside the engine."""
        self._say(b"act")

    async def done(self, *, safe: bool) -> None:
        """End it where the rig is `safe`; otherwise leave it to make the rig safe when this process is gone."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        watching, self._watching = self._watching, False
        if self._socket is None or self._process is None:
            return
        if safe or not watching:
            self._say(b"done")
        with contextlib.suppress(OSError):
            self._socket.close()
        self._socket = None
        # Where it still tries to make the rig safe it is left alone: it outlives this process, and its log says more.
        for _ in range(200 if safe or not watching else 0):
            if self._process.poll() is not None:
                break
            await asyncio.sleep(0.01)
        if self._process.returncode is None:
            self._process.returncode = 0  # no warning about a process that is meant to go on

    def _say(self, line: bytes) -> None:
        if self._socket is None:
            return
        try:
            self._socket.send(line + b"\n", socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except BlockingIOError:
            pass  # it does not read: `failure` says so
        except OSError as error:
            self._lost = self._lost or error.strerror or "its socket is closed"

    def _receive(self) -> None:
        if self._socket is None:
            return
        # While this process was paused the guardian may have been silent with it: such time does not count.
        now = steady_s()
        self._mute_s += min(now - self._looked_s, 2.0 * BEAT_EVERY_S)
        self._looked_s = now
        if not self._poll.poll(0):  # far cheaper than the exception of an empty socket
            return
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost = self._lost or error.strerror or "its socket is closed"
            return
        if not data:
            self._lost = self._lost or "its process has ended"
            return
        self._heard_s, self._mute_s = now, 0.0
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for line in lines:
            self._take(line)

    def _take(self, line: bytes) -> None:
        if not line.startswith(b"{"):
            return
        document: dict[str, Any] = json.loads(line)
        if "acted" in document:
            self.acted = Acted(**document["acted"])
        elif "checked" in document:
            self._sure = bool(document["checked"])
        elif "probe" in document and self._probed is not None and not self._probed.done():
            self._probed.set_result(document["probe"])


def _later(wire: dict[str, Any]) -> str:
    """Return the time that the guardian needs on a wire which it has to open first, where that is out of the ordinary;
    the text continues a sentence."""
    needs_s = takes_s(wire["connect_delay_s"])
    if needs_s <= SAFE_WITHIN_S:
        return ""
    return (
        f"; the device takes no request for {wire['connect_delay_s']:g} s after connecting, so that the guardian needs "
        f"about {needs_s:g} s to make it safe"
    )
