"""Arrival times of frames that wait in a queue until a thread takes them out.

A frame that is taken out now has arrived after the queue was last seen empty. While the thread runs that is a moment
ago. A thread that was stopped (SIGSTOP, a suspended machine, a paused virtual machine) finds old frames beside new
ones. After such a gap every frame counts as old as the gap, until the queue is seen empty again or a time stamp shows
that the frame is younger. An error of this estimate makes a value older than it is, never younger.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Literal

from drivers.bus.steady_time import steady_s

RECEIVE_TIMEOUT_S = 0.2
STALL_S = 0.1
"""A receiving thread that comes back later than its time-out and this has been stopped. Shorter stalls stay unseen:
they make a value at most `RECEIVE_TIMEOUT_S + STALL_S` older than its stamp."""
_UNSEEN_S = RECEIVE_TIMEOUT_S + STALL_S
REFILL_S = 0.1
"""An empty queue may fill again from the buffers behind it: a sender's socket, an adapter. It is looked at again after
this time, which is longer than a round trip in a local network and than the latency of a USB adapter."""
RELAY_EMPTIES_IN_S = 1.0
"""The sender's stamps count for so long after the queue was seen empty; then its buffers are empty too, and stamps that
still lag come from a clock that was set meanwhile."""
LAG_S = 0.2
"""Lag of a sender's stamp that its own jitter can explain."""
JUMP_S = 0.05
"""A wall clock that gains or loses so much between two frames has been set; slewing changes it by 0.05 % at most."""

Stamps = Literal["kernel", "sender", "none"]
_Moment = tuple[float, float]
"""The same moment on the steady clock and on the rig's, s."""


class Arrivals:
    """Arrival times on the rig's clock, in s, of frames out of one queue.

    `stamps` are the time stamps that frames carry: `kernel` is this machine's wall clock at the socket, `sender` the
    clock of a relay whose offset is not known, and `none` is none, or one that is made when the frame is taken out.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        stamps: Stamps = "none",
        *,
        steady: Callable[[], float] = steady_s,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self.in_step = False
        """True where the rig waits for the harness before each step: its time stands still in a gap, no frame ages."""
        self._clock = clock
        self._stamps = stamps
        self._is_kernel = stamps == "kernel"
        self._steady = steady
        self._wall = wall
        self.restart()

    def restart(self) -> None:
        """Begin with a queue that is empty now."""
        self._seen: _Moment = (self._steady(), self._clock())
        self._empty = self._seen
        self._gap: _Moment | None = None
        self._empty_since: float | None = None
        self._offset = self._wall() - self._seen[0]
        self._wall_was_set = False
        self._reference: tuple[float, float] | None = None
        self._lag_s = 0.0

    @property
    def in_doubt(self) -> bool:
        """Whether frames from before the end of a gap may still be in the queue."""
        return self._gap is not None

    @property
    def wait_s(self) -> float:
        """Time-out of the next receive call, s; 0 while only an empty queue ends the doubt."""
        return 0.0 if self.in_doubt else RECEIVE_TIMEOUT_S

    def frame(self, stamp: float) -> float:
        """Return the arrival on the rig's clock, in s, of the frame that was just taken out; `stamp` is its own."""
        if self.in_step:
            return self._clock()
        self._look()
        now = self._seen
        if self._is_kernel and not self._wall_was_set:
            return self._aged(self._wall() - stamp, self._gap or self._empty)
        if self._gap is None:
            self._reference = (now[0], stamp)
            return now[1]
        if self._stamps != "sender" or self._reference is None or self._empty_since is None:
            return self._gap[1]
        then, stamp_then = self._reference
        self._lag_s = (now[0] - then) - (stamp - stamp_then)
        return self._aged(self._lag_s, self._gap)

    def empty(self) -> None:
        """Take note that a receive call has found nothing."""
        if self.in_step or self._look():  # a call that returns late may have looked long ago
            return
        now_s = self._seen[0]
        self._empty = self._seen
        self._wall_was_set = False
        if self._gap is None:
            return
        if self._empty_since is None:
            self._empty_since = now_s
        lags = self._stamps == "sender" and self._lag_s > LAG_S
        settled_s = RELAY_EMPTIES_IN_S if lags else 0.0 if self._stamps == "kernel" else REFILL_S
        if now_s - self._empty_since >= settled_s:
            self._gap = self._empty_since = None
            self._lag_s = 0.0

    def _look(self) -> bool:
        """Read the clocks; True where the thread was stopped since they were read last."""
        was, now_s = self._seen, self._steady()
        self._seen = (now_s, self._clock())
        if self._is_kernel:  # the wall clock counts with its stamps only
            offset = self._wall() - now_s
            self._wall_was_set |= abs(offset - self._offset) > JUMP_S
            self._offset = offset
        if now_s - was[0] <= _UNSEEN_S:
            return False
        if self._gap is None:
            self._gap = was
        self._empty_since = None
        return True

    def _aged(self, age_s: float, since: _Moment) -> float:
        """Rig time `age_s` ago on the steady clock, but not before `since`."""
        now = self._seen
        passed_s = now[0] - since[0]
        if age_s <= 0.0 or passed_s <= 0.0:
            return now[1]
        return now[1] - (now[1] - since[1]) * min(age_s / passed_s, 1.0)
