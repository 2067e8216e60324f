"""Requests of operators to a live run: asked from anywhere on the loop, obeyed and answered in the tick."""

from __future__ import annotations

import asyncio
import enum
from collections import deque
from dataclasses import dataclass

from hil.journal import LIVE, UNTOUCHED, RunEvent, State, next_state


class Verb(enum.StrEnum):
    """Request that an operator may make."""

    HOLD = "hold"
    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"
    ACK = "ack"


URGENT = (Verb.PAUSE,)
"""Verbs that make the outputs safe: they are not kept waiting for the next tick. Abort ends the run by itself."""
_EVENTS = {Verb.HOLD: RunEvent.HOLD, Verb.PAUSE: RunEvent.PAUSE, Verb.RESUME: RunEvent.RESUME}
_ALREADY = {
    Verb.HOLD: {State.HELD},
    Verb.PAUSE: {State.PAUSED},
    Verb.RESUME: {State.RUNNING, State.RESTORING},
}


class RefusedError(Exception):
    """Request that the run cannot obey; the message states why and what to do."""


@dataclass(frozen=True, slots=True)
class Request:
    """One thing that was asked; `answer` is what the operator gets to read."""

    verb: Verb
    reason: str
    answer: asyncio.Future[str]

    def done(self, text: str) -> None:
        """Answer that it is done."""
        if not self.answer.done():
            self.answer.set_result(text)

    def refuse(self, why: str) -> None:
        """Answer that it cannot be."""
        if not self.answer.done():
            self.answer.set_exception(RefusedError(why))


class Desk:
    """Requests between two ticks, in the order in which they came."""

    def __init__(self) -> None:
        self._asked: deque[Request] = deque()

    async def ask(self, verb: Verb, reason: str) -> str:
        """Ask, and wait for the tick that obeys; raises RefusedError."""
        request = Request(verb, reason, asyncio.get_running_loop().create_future())
        self._asked.append(request)
        return await request.answer

    def take(self) -> list[Request]:
        """Return the requests since the last call."""
        asked = list(self._asked)
        self._asked.clear()
        return asked

    def take_urgent(self) -> list[Request]:
        """Return what was asked up to the last request that makes safe, in order; the rest waits for the tick."""
        last = max((k for k, request in enumerate(self._asked, 1) if request.verb in URGENT), default=0)
        return [self._asked.popleft() for _ in range(last)]


def event_of(verb: Verb, *, restoring: bool) -> RunEvent:
    """Return the event of `verb` in the state table; a run in thermal restore (`restoring`) resumes that."""
    return RunEvent.RESTORE if restoring and verb is Verb.RESUME else _EVENTS[verb]


def unheard(state: State) -> str | None:
    """Return why a run in `state` takes no verb but abort, or None where it takes them on its next tick."""
    if state in UNTOUCHED:
        return f"a run that is {state} can only be aborted; ask again when it runs"
    if state in LIVE or state is State.RESTORING:
        return None
    return f"the run is {state}: its outputs go to their safe values, and it takes no verb any more"


def refusal(state: State, verb: Verb, trips: tuple[str, ...], *, restoring: bool) -> str | None:
    """Return why a run in `state` with latched `trips` does not obey `verb`, or None."""
    if verb is Verb.ACK:
        return None if trips else "nothing has tripped, so there is nothing to acknowledge"
    if verb is Verb.RESUME and trips:
        return f"tripped: {trips[0]}; remove the cause, then `hil ctl ack`, then resume"
    if verb is Verb.RESUME and state is State.SUSPENDED:
        return "a warning suspends the run; it goes on by itself when that is gone (`hil ctl status` names it)"
    if next_state(state, event_of(verb, restoring=restoring)) is None and state not in _ALREADY[verb]:
        return f"a run that is {state} cannot {verb}: its outputs are at their safe values"
    return None
