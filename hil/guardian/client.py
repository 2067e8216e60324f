"""Engine's half of the guardian: it starts the process, sends the plan before arming, and beats while ticks go on."""

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

from drivers.bus import steady_s
from drivers.rig_file import Rig
from drivers.signals import LinkError
from hil.guardian.plan import plan_of
from hil.run.outputs import SAFE_WITHIN_S, SILENCE_S, takes_s

BEAT_EVERY_S = 0.2
"""Interval of beats, s: five beats within the silence on which the guardian acts."""
TICK_BEATS_AFTER_S = 0.75 * BEAT_EVERY_S
"""Age of the last beat, s, from which on a tick gives the next one, ahead of the loop's timer, which so stays
asleep."""
POLL_EVERY_S = 0.02
"""Least interval of polls for messages of the guardian, s: far below the silence on which it acts."""
FENCE_S = 0.8 * SILENCE_S
"""Silence of the engine, s, after which the guardian may have acted: the engine writes no heat until it has an
answer."""
STARTS_WITHIN_S = 10.0
"""Longest wait for an answer of the guardian's process, s."""
MUTE_AFTER_S = 2.0
"""Silence of the guardian, s of this process's running time, after which it counts as gone."""
ENDS_WITHIN_S = 2
"""Longest wait for the end of a guardian that is not needed any more, s."""
_PACKAGE = Path(__file__).resolve().parents[2]


class GuardianError(LinkError):
    """Guardian that cannot guard this rig; the message names the part that would not be guarded."""


@dataclass(frozen=True, slots=True)
class GuardianReport:
    """Report of a guardian that has acted: reason, result and meter readings.

    `safe` is True where the safe values are read back and the meters agree, else `problem` states the difference.
    `meters` maps meter names to readings in their units.
    """

    reason: str
    safe: bool
    problem: str
    meters: dict[str, float] = field(default_factory=dict)

    def sentence(self, *, run_is_safe: bool) -> str:
        """Return reason and result for the end of a run, which may have read the safe values back itself."""
        if self.safe:
            return f"{self.reason}; safe values read back"
        since = "; the run itself has read the safe values back" if run_is_safe else ""
        return f"{self.reason}; {self.problem}{since}"


class Guard(Protocol):
    """Interface of a guardian for the engine."""

    acted: GuardianReport | None

    async def start(self) -> None:
        """Start the guardian and send it the plan; raises GuardianError."""

    async def probe(self) -> list[str]:
        """Return why wires cannot be reached beside the engine; on these the guardian has to end the engine first."""

    def watch(self) -> None:
        """Arm the guardian: from now on silence counts."""

    def expect(self, within_s: float) -> None:
        """Beat without ticks for `within_s` seconds; a tick that takes longer is silence."""

    def may_heat(self) -> bool:
        """Return True where this engine certainly has control: it was not silent, and the guardian has not acted."""

    def failure(self) -> str | None:
        """Return why the run has to end (the guardian is gone, or has acted), or None."""

    def act(self) -> None:
        """Have the guardian make the rig safe now, beside the engine."""

    async def done(self, *, safe: bool) -> None:
        """End the guardian; without `safe` it makes the rig safe as soon as this process is gone."""


class NoGuard:
    """Absence of a guardian: the rig is this process's own virtual one, or the operator chose --no-guardian."""

    acted: GuardianReport | None = None

    async def start(self) -> None:
        """Do nothing: there is no process."""

    async def probe(self) -> list[str]:
        """Return an empty list: no wire has to be reached."""
        return []

    def watch(self) -> None:
        """Do nothing: there is nothing to arm."""

    def expect(self, within_s: float) -> None:
        """Do nothing: nobody waits for beats."""

    def may_heat(self) -> bool:
        """Return True: nobody else has control."""
        return True

    def failure(self) -> str | None:
        """Return None: nothing can fail."""
        return None

    def act(self) -> None:
        """Do nothing: there is nobody to ask."""

    async def done(self, *, safe: bool) -> None:
        """Do nothing: there is no process."""


class GuardianClient:
    """Guardian of one run with its process. `log` is its file, `keep` are descriptors that it holds open while it
    lives.

    The rig's locks are among them, so that nobody else drives the rig before the guardian has made it safe.
    """

    def __init__(self, rig: Rig, log: Path, keep: Sequence[int] = ()) -> None:
        self.acted: GuardianReport | None = None
        self._plan = plan_of(rig)
        self._log = log
        self._keep = tuple(keep)
        self._socket: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._buffer = b""
        self._probed: asyncio.Future[list[str]] | None = None
        self._until = self._beat_s = self._heard_s = self._polled_s = self._mute_s = 0.0
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
        """Start the process and send it the plan; raises GuardianError where it does not answer."""
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
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(), *self._keep),
                    cwd="/",
                    start_new_session=True,
                )
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
        self._send(b"probe")
        # The guardian waits out the time after connecting in which a device takes no request.
        end = steady_s() + STARTS_WITHIN_S + sum(wire["connect_delay_s"] for wire in self._plan["wires"])
        while not self._probed.done():
            self._receive()
            if self._lost is not None or steady_s() > end:
                raise GuardianError(f"not armed: the guardian is gone ({self._lost or 'no answer'})")
            await asyncio.sleep(0.005)
        wires = self._plan["wires"]
        return [why + _late_note(wire) for wire, why in zip(wires, self._probed.result(), strict=True) if why]

    def watch(self) -> None:
        """Arm the guardian: from now on silence counts."""
        if self._socket is None:
            return
        self._send(b"watch")
        self._watching = True
        self._beat_s, self._mute_s = steady_s(), 0.0
        self._loop = asyncio.get_running_loop()
        self.expect(STARTS_WITHIN_S)
        self._arm_timer()

    def expect(self, within_s: float) -> None:
        """Beat now and, by the loop, for `within_s` seconds of wall time; a tick that takes longer is silence."""
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
            self._sure = False  # until the guardian answers that it has not acted meanwhile
            self._send(b"check")
        self._send(b"beat")
        self._beat_s = now

    def may_heat(self) -> bool:
        """Return True where the guardian certainly had beats, and has not acted."""
        if not self._watching:
            return True
        now = steady_s()
        if now - self._beat_s > FENCE_S:
            return False
        if now - self._polled_s > POLL_EVERY_S:
            self._receive()
        return self._sure and self.acted is None and self._lost is None

    def failure(self) -> str | None:
        """Return why the run has to end (the guardian has acted, is gone or does not answer), or None."""
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
        """Have the guardian make the rig safe now, beside the engine."""
        self._send(b"act")

    async def done(self, *, safe: bool) -> None:
        """End the guardian where the rig is `safe`; else leave it to make the rig safe when this process is gone."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        watching, self._watching = self._watching, False
        if self._socket is None or self._process is None:
            return
        if safe or not watching:
            self._send(b"done")
            # Its last report may be of an attempt that was under way when this engine made the rig safe.
            for _ in range(ENDS_WITHIN_S * 100):
                has_ended = self._process.poll() is not None
                self._receive()
                if has_ended:
                    break
                await asyncio.sleep(0.01)
        # A guardian that still tries to make the rig safe goes on: it outlives this process, and its log has the
        # details.
        with contextlib.suppress(OSError):
            self._socket.close()
        self._socket = None
        if self._process.returncode is None:
            self._process.returncode = 0  # no warning about a process that is meant to go on

    def _send(self, line: bytes) -> None:
        if self._socket is None:
            return
        try:
            self._socket.send(line + b"\n", socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
        except BlockingIOError:
            pass  # it does not read: `failure` reports that
        except OSError as error:
            self._lost = self._lost or error.strerror or "its socket is closed"

    def _receive(self) -> None:
        if self._socket is None:
            return
        # While this process was paused the guardian may have been silent with it: such time does not count.
        now = steady_s()
        self._mute_s += min(now - self._polled_s, 2.0 * BEAT_EVERY_S)
        self._polled_s = now
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
            self._handle(line)

    def _handle(self, line: bytes) -> None:
        if not line.startswith(b"{"):
            return
        document: dict[str, Any] = json.loads(line)
        if "acted" in document:
            self.acted = GuardianReport(**document["acted"])
        elif "checked" in document:
            self._sure = bool(document["checked"])
        elif "probe" in document and self._probed is not None and not self._probed.done():
            self._probed.set_result(document["probe"])


def _late_note(wire: dict[str, Any]) -> str:
    """Return the end of a sentence with the guardian's time on a wire that it has to open first; "" for a usual
    time."""
    needs_s = takes_s(wire["connect_delay_s"])
    if needs_s <= SAFE_WITHIN_S:
        return ""
    return (
        f"; the device takes no request for {wire['connect_delay_s']:g} s after connecting, so that the guardian needs "
        f"about {needs_s:g} s to make it safe"
    )
