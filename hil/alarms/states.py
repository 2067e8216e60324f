"""State model of an alarm as a table: ANSI/ISA-18.2-2016, figure 3, with latching and shelving.

A shelved alarm forgets nothing about its condition: one that is there at the end of the shelving asks for an
acknowledgement again.
"""

from __future__ import annotations

import enum


class AlarmState(enum.StrEnum):
    """State of one alarm."""

    NORMAL = "normal"
    UNACKNOWLEDGED = "unacknowledged"  # the condition is there, nobody has acknowledged it
    ACKNOWLEDGED = "acknowledged"  # the condition is there, somebody has
    RETURNED = "returned unacknowledged"  # the condition has gone before anybody acknowledged it
    LATCHED = "latched"  # the condition has gone after it was acknowledged; a latching alarm waits once more
    SHELVED = "shelved"  # out of the list until an end; the condition is not there
    SHELVED_ACTIVE = "shelved, active"  # the same with the condition there


class AlarmEvent(enum.StrEnum):
    """Event of one alarm: its condition comes or goes, or an operator acts, or the shelving ends."""

    RAISE = "raise"
    CLEAR = "clear"
    ACKNOWLEDGE = "acknowledge"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"


_S, _E = AlarmState, AlarmEvent
TABLE: dict[tuple[AlarmState, AlarmEvent], AlarmState] = {
    (_S.NORMAL, _E.RAISE): _S.UNACKNOWLEDGED,
    (_S.RETURNED, _E.RAISE): _S.UNACKNOWLEDGED,
    (_S.LATCHED, _E.RAISE): _S.UNACKNOWLEDGED,
    (_S.UNACKNOWLEDGED, _E.CLEAR): _S.RETURNED,
    (_S.ACKNOWLEDGED, _E.CLEAR): _S.NORMAL,
    (_S.UNACKNOWLEDGED, _E.ACKNOWLEDGE): _S.ACKNOWLEDGED,
    (_S.RETURNED, _E.ACKNOWLEDGE): _S.NORMAL,
    (_S.LATCHED, _E.ACKNOWLEDGE): _S.NORMAL,
    # What waits for an acknowledgement alone is not shelved: acknowledging it ends the matter.
    (_S.NORMAL, _E.SHELVE): _S.SHELVED,
    (_S.UNACKNOWLEDGED, _E.SHELVE): _S.SHELVED_ACTIVE,
    (_S.ACKNOWLEDGED, _E.SHELVE): _S.SHELVED_ACTIVE,
    (_S.SHELVED, _E.SHELVE): _S.SHELVED,  # with another end
    (_S.SHELVED_ACTIVE, _E.SHELVE): _S.SHELVED_ACTIVE,
    (_S.SHELVED, _E.RAISE): _S.SHELVED_ACTIVE,
    (_S.SHELVED_ACTIVE, _E.CLEAR): _S.SHELVED,
    (_S.SHELVED, _E.UNSHELVE): _S.NORMAL,
    (_S.SHELVED_ACTIVE, _E.UNSHELVE): _S.UNACKNOWLEDGED,
}
LATCHING = {(_S.ACKNOWLEDGED, _E.CLEAR): _S.LATCHED}
"""Transitions of a latching alarm that differ from those of the table."""
ACTIVE = frozenset({_S.UNACKNOWLEDGED, _S.ACKNOWLEDGED, _S.SHELVED_ACTIVE})
"""States in which the condition is there."""
SHELVED = frozenset({_S.SHELVED, _S.SHELVED_ACTIVE})
"""States in which the alarm is shelved."""
WAITING = frozenset({_S.UNACKNOWLEDGED, _S.RETURNED, _S.LATCHED})
"""States that wait for an operator."""


def next_alarm_state(state: AlarmState, event: AlarmEvent, *, latching: bool = False) -> AlarmState | None:
    """Return the state after `event` in `state`; None where the table has no such transition."""
    if latching and (state, event) in LATCHING:
        return LATCHING[state, event]
    return TABLE.get((state, event))
