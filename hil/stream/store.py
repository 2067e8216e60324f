"""Protocol of a store that a stream fills, and the blocks that it is given."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.signals import Signal


@dataclass(frozen=True, slots=True)
class Position:
    """Last tick and id of the last event that a store has confirmed; -1 and 0 before the first."""

    tick: int = -1
    event: int = 0


@dataclass(frozen=True, slots=True)
class RunIdentity:
    """Identity of a run: unique id, name of its folder, profile, period in s of rig time, signals, name of the rig."""

    uid: str
    name: str
    profile: str
    period_s: float
    signals: tuple[Signal, ...]
    rig: str = "rig"


@dataclass(frozen=True, slots=True)
class RunState:
    """State of a run at `time_us`, µs since 1970 (UTC), with its reason."""

    name: str
    time_us: int
    reason: str


@dataclass(frozen=True, slots=True)
class RunEvent:
    """Event of a run at `time_us`, µs since 1970 (UTC); `level` is INFO, WARN or ERROR."""

    id: int
    time_us: int
    level: str
    text: str


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """Part of a run after `before`: `tick (n,)`, `time_us (n,)`, `values (n, k)`, `quality (n, k)`, events, state.

    Times are in µs since 1970 (UTC), values in the units of their signals and NaN where missing or not GOOD. `received`
    `(n, k)` are the values as they were read, also those that are not GOOD.
    """

    before: Position
    tick: NDArray[np.int64]
    time_us: NDArray[np.int64]
    values: NDArray[np.float64]
    received: NDArray[np.float64]
    quality: NDArray[np.uint8]
    events: tuple[RunEvent, ...]
    state: RunState

    @property
    def is_empty(self) -> bool:
        """Return True without samples and events."""
        return not len(self.tick) and not self.events

    @property
    def after(self) -> Position:
        """Return the position once this block is confirmed."""
        return Position(
            int(self.tick[-1]) if len(self.tick) else self.before.tick,
            self.events[-1].id if self.events else self.before.event,
        )


class Store(Protocol):
    """Open connection to a store of one run. Every method may raise StoreDownError or StreamError."""

    longest_block: int
    """Ticks of a block at most."""
    stays: bool
    """True for a server, which goes on after the end of the run."""

    def position(self) -> Position:
        """Return the confirmed position, after which the stream goes on."""

    def send(self, block: Block) -> Position:
        """Send a block and return the position that the store has confirmed."""

    def close(self, *, ended: bool) -> None:
        """Close the connection; `ended` is True where the run has ended and all of it is there. Never raises."""


def iso_time(time_us: int) -> str:
    """Return µs since 1970 as UTC time of ISO 8601, with µs."""
    moment = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC) + datetime.timedelta(microseconds=time_us)
    return moment.isoformat(timespec="microseconds").replace("+00:00", "Z")
