"""The states of a run and the only ways from one to another, as a table.

Names follow ANSI/ISA-88.00.01 (5.6) and PackML (ISA-TR88.00.02) where they mean the same: `held` is an operator's, and
keeps the outputs; `suspended` is the process's, and ends by itself. `paused` is Open-Pectus' pause: an operator's, with
safe outputs. Terms of the rig's outputs:

    running                      moved towards the profile, no faster than the slew rates
    soaking                      at their safe values until armed; of a run that was cut, moved so as to lead the rig
                                 back to where it was, no faster than the slew rates
    held                         kept as they are
    paused, suspended, finishing at their safe values
    idle, validating, connecting untouched
    done, aborted, faulted       left at their safe values

The profile's clock goes in `running` alone; that of a soak stands in `held` and `paused`.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass


class State(enum.StrEnum):
    """Where a run is."""

    IDLE = "idle"
    VALIDATING = "validating"
    CONNECTING = "connecting"
    RESTORING = "soaking"
    RUNNING = "running"
    HELD = "held"
    PAUSED = "paused"
    SUSPENDED = "suspended"
    FINISHING = "finishing"
    DONE = "done"
    ABORTED = "aborted"
    FAULTED = "faulted"


class Event(enum.StrEnum):
    """What moves a run: an operator's verb, or what happened."""

    VALIDATE = "validate"
    CONNECT = "connect"
    RESTORE = "soak"
    START = "start"
    HOLD = "hold"
    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"
    WARN = "warn"  # a warning became active
    CLEAR = "clear"  # all warnings are gone, and have been for their settle times
    TRIP = "trip"  # an alarm, and the run waits for an acknowledgement
    FAIL = "fail"  # an alarm that ends the run, a fault of rig, link or journal, a defect
    COMPLETE = "complete"


_S, _E = State, Event

TABLE: dict[tuple[State, Event], State] = {
    (_S.IDLE, _E.VALIDATE): _S.VALIDATING,
    (_S.VALIDATING, _E.CONNECT): _S.CONNECTING,
    (_S.CONNECTING, _E.RESTORE): _S.RESTORING,
    (_S.RESTORING, _E.START): _S.RUNNING,
    (_S.RUNNING, _E.HOLD): _S.HELD,
    (_S.RUNNING, _E.PAUSE): _S.PAUSED,
    (_S.HELD, _E.PAUSE): _S.PAUSED,
    (_S.SUSPENDED, _E.PAUSE): _S.PAUSED,
    (_S.HELD, _E.RESUME): _S.RUNNING,
    (_S.PAUSED, _E.RESUME): _S.RUNNING,
    (_S.RUNNING, _E.WARN): _S.SUSPENDED,
    # What an operator stopped does not go on by itself when a warning has gone.
    (_S.HELD, _E.WARN): _S.PAUSED,
    (_S.SUSPENDED, _E.CLEAR): _S.RUNNING,
    # A rig that is led back goes on being led back, and not with the profile, whoever or whatever stopped it.
    (_S.RESTORING, _E.HOLD): _S.HELD,
    (_S.RESTORING, _E.PAUSE): _S.PAUSED,
    (_S.RESTORING, _E.WARN): _S.SUSPENDED,
    **{(state, _E.RESTORE): _S.RESTORING for state in (_S.HELD, _S.PAUSED, _S.SUSPENDED)},
    **{(state, _E.TRIP): _S.PAUSED for state in (_S.RUNNING, _S.HELD, _S.SUSPENDED, _S.PAUSED)},
    (_S.RUNNING, _E.COMPLETE): _S.FINISHING,
    **{
        (state, event): _S.FINISHING
        for state in (_S.RESTORING, _S.RUNNING, _S.HELD, _S.PAUSED, _S.SUSPENDED)
        for event in (_E.ABORT, _E.FAIL)
    },
    # Before anything was written there is nothing to make safe.
    **{(state, _E.ABORT): _S.ABORTED for state in (_S.IDLE, _S.VALIDATING, _S.CONNECTING)},
    **{(state, _E.FAIL): _S.FAULTED for state in (_S.IDLE, _S.VALIDATING, _S.CONNECTING)},
    (_S.FINISHING, _E.COMPLETE): _S.DONE,
    (_S.FINISHING, _E.ABORT): _S.ABORTED,
    (_S.FINISHING, _E.FAIL): _S.FAULTED,
}

UNTOUCHED = frozenset({State.IDLE, State.VALIDATING, State.CONNECTING})
"""States in which nothing has been written to the rig yet."""
ENDED = frozenset({State.DONE, State.ABORTED, State.FAULTED})
LIVE = frozenset({State.RUNNING, State.HELD, State.PAUSED, State.SUSPENDED})
"""States in which the loop ticks, beside the soaking of a run that was cut."""
HEATED = frozenset({State.RESTORING, State.RUNNING, State.HELD})
"""The only states in which an output may be away from its safe value."""
WAITING = frozenset({State.HELD, State.PAUSED})
"""States that a person ends."""


class TransitionError(Exception):
    """The table has no such way."""


@dataclass(frozen=True, slots=True)
class Transition:
    """One step along the table, and why."""

    source: State
    event: Event
    target: State
    reason: str


def next_state(state: State, event: Event) -> State | None:
    """Where `event` leads from `state`; None where it leads nowhere."""
    return TABLE.get((state, event))


def event_level(step: Transition) -> str:
    """How loud a transition is: INFO, WARN or ERROR."""
    if step.event is Event.FAIL or step.event is Event.TRIP:
        return "ERROR"
    return "WARN" if step.event in (Event.WARN, Event.ABORT) else "INFO"


class StateMachine:
    """The state of one run. Every transition is passed to `told`, which must not raise."""

    def __init__(self, told: Callable[[Transition], None]) -> None:
        self.state = State.IDLE
        self.reason = ""
        self._told = told

    def take(self, event: Event, reason: str) -> State:
        """Take the way of `event`; raises TransitionError where there is none."""
        target = next_state(self.state, event)
        if target is None:
            raise TransitionError(f"a run that is {self.state} knows no {event}")
        transition = Transition(self.state, event, target, reason)
        self.state, self.reason = target, reason
        self._told(transition)
        return target
