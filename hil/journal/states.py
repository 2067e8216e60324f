"""State machine of a run as a table of transitions.

Names follow ANSI/ISA-88.00.01 (5.6) and PackML (ISA-TR88.00.02) where they mean the same: an operator requests `held`,
which keeps the outputs; the process causes `suspended`, which ends by itself. `paused` is the pause of Open-Pectus: an
operator requests it, with safe outputs. The rig's outputs in each state:

    running                      moved towards the profile, no faster than the slew rates
    restoring                    at their safe values until armed; in a resumed run moved by the thermal restore, no
                                 faster than the slew rates
    held                         kept as they are
    paused, suspended, finishing at their safe values
    idle, validating, connecting untouched
    done, aborted, faulted       left at their safe values

The profile's clock runs in `running` alone. The clock of a thermal restore stands in `held` and `paused`.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass


class State(enum.StrEnum):
    """State of a run, as in journals and messages."""

    IDLE = "idle"
    VALIDATING = "validating"
    CONNECTING = "connecting"
    RESTORING = "restoring"  # warm-up of a new run, thermal restore of a resumed one
    RUNNING = "running"
    HELD = "held"
    PAUSED = "paused"
    SUSPENDED = "suspended"
    FINISHING = "finishing"
    DONE = "done"
    ABORTED = "aborted"
    FAULTED = "faulted"

    @classmethod
    def _missing_(cls, value: object) -> State | None:
        """Return the state of a name that journals before version 0.2 have."""
        return cls.RESTORING if value == "soaking" else None


class RunEvent(enum.StrEnum):
    """Cause of a transition: an operator's verb, or an event of the run."""

    VALIDATE = "validate"
    CONNECT = "connect"
    RESTORE = "restore"
    START = "start"
    HOLD = "hold"
    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"
    WARN = "warn"  # a warning became active
    CLEAR = "clear"  # all warnings are gone, and have been for their settle times
    TRIP = "trip"  # an alarm, and the run waits for an acknowledgement
    FAIL = "fail"  # an alarm that ends the run, a fault of rig or link
    FAULT = "fault"  # a fault of this bench: journal, guardian, a defect
    COMPLETE = "complete"


_S, _E = State, RunEvent

TABLE: dict[tuple[State, RunEvent], State] = {
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
    # A run that an operator stopped does not continue by itself when a warning has gone.
    (_S.HELD, _E.WARN): _S.PAUSED,
    (_S.SUSPENDED, _E.CLEAR): _S.RUNNING,
    # A thermal restore that was stopped is continued as a restore, and not with the profile.
    (_S.RESTORING, _E.HOLD): _S.HELD,
    (_S.RESTORING, _E.PAUSE): _S.PAUSED,
    (_S.RESTORING, _E.WARN): _S.SUSPENDED,
    **{(state, _E.RESTORE): _S.RESTORING for state in (_S.HELD, _S.PAUSED, _S.SUSPENDED)},
    **{(state, _E.TRIP): _S.PAUSED for state in (_S.RUNNING, _S.HELD, _S.SUSPENDED, _S.PAUSED)},
    (_S.RUNNING, _E.COMPLETE): _S.FINISHING,
    **{
        (state, event): _S.FINISHING
        for state in (_S.RESTORING, _S.RUNNING, _S.HELD, _S.PAUSED, _S.SUSPENDED)
        for event in (_E.ABORT, _E.FAIL, _E.FAULT)
    },
    # Before anything was written there is nothing to make safe.
    **{(state, _E.ABORT): _S.ABORTED for state in (_S.IDLE, _S.VALIDATING, _S.CONNECTING)},
    **{
        (state, event): _S.FAULTED for state in (_S.IDLE, _S.VALIDATING, _S.CONNECTING) for event in (_E.FAIL, _E.FAULT)
    },
    (_S.FINISHING, _E.COMPLETE): _S.DONE,
    (_S.FINISHING, _E.ABORT): _S.ABORTED,
    (_S.FINISHING, _E.FAIL): _S.FAULTED,
    (_S.FINISHING, _E.FAULT): _S.FAULTED,
}

UNTOUCHED = frozenset({State.IDLE, State.VALIDATING, State.CONNECTING})
"""States in which nothing has been written to the rig yet."""
ENDED = frozenset({State.DONE, State.ABORTED, State.FAULTED})
"""Final states."""
LIVE = frozenset({State.RUNNING, State.HELD, State.PAUSED, State.SUSPENDED})
"""States in which the loop ticks, besides the thermal restore of a resumed run."""
HEATED = frozenset({State.RESTORING, State.RUNNING, State.HELD})
"""States in which an output may differ from its safe value; in all others it may not."""
WAITING = frozenset({State.HELD, State.PAUSED})
"""States that a person ends."""


ACKNOWLEDGED = "trip acknowledged"
"""Begin of the event that a trip was acknowledged: the run stays paused, so that there is no transition."""

NO_TICK = "no tick for"
"""Begin of the sentence of a trip because this process or its machine was paused: a fault of the bench."""


class TransitionError(Exception):
    """Event that has no transition from the present state."""


@dataclass(frozen=True, slots=True)
class Transition:
    """Transition of the table, with its reason."""

    source: State
    event: RunEvent
    target: State
    reason: str


def next_state(state: State, event: RunEvent) -> State | None:
    """Return the state after `event` in `state`; None where the table has no such transition."""
    return TABLE.get((state, event))


def event_level(step: Transition) -> str:
    """Return the level of the event of a transition: INFO, WARN or ERROR."""
    if step.event in (RunEvent.FAIL, RunEvent.FAULT, RunEvent.TRIP):
        return "ERROR"
    return "WARN" if step.event in (RunEvent.WARN, RunEvent.ABORT) else "INFO"


class StateMachine:
    """State machine of one run. Every transition is passed to `on_transition`, which must not raise."""

    def __init__(self, on_transition: Callable[[Transition], None]) -> None:
        self.state = State.IDLE
        self.reason = ""
        self._on_transition = on_transition

    def take(self, event: RunEvent, reason: str) -> State:
        """Make the transition of `event` and return the new state; raises TransitionError where there is none."""
        target = next_state(self.state, event)
        if target is None:
            raise TransitionError(f"a run that is {self.state} knows no {event}")
        transition = Transition(self.state, event, target, reason)
        self.state, self.reason = target, reason
        self._on_transition(transition)
        return target
