"""Lines that wait to be sent, and the rate at which messages may leave. No input or output."""

from __future__ import annotations

from collections.abc import Sequence

from hil.alarms.alarm_list import AlarmList, AlarmRecord, utc
from hil.alarms.definitions import PRIORITIES
from hil.alarms.show import condition_of, value_of
from hil.alarms.states import ACTIVE, SHELVED, AlarmEvent, AlarmState
from hil.files import plain

HOUR_S = 3600.0
MOST_LINES = 50
"""Lines of a message; the rest is counted."""
Key = tuple[str, str, int, float]
"""Identity of a transition: alarm, event, tick, and the time of one that has no tick."""


def key_of(record: AlarmRecord) -> Key:
    """Return the identity of a transition among all of its run."""
    return record.id, record.event.value, record.tick, record.wall_s if record.tick < 0 else 0.0


def is_announced(record: AlarmRecord) -> bool:
    """Return True for a transition that people are told of: an alarm that comes, or the end of one that had."""
    if record.target is AlarmState.UNACKNOWLEDGED:
        return True
    return record.event is AlarmEvent.CLEAR and record.source in ACTIVE and record.source not in SHELVED


def line_of(record: AlarmRecord, kept: AlarmList) -> str:
    """Return a transition as one line."""
    item = kept.statuses[record.id].definition
    came = record.target is AlarmState.UNACKNOWLEDGED
    value = value_of(item, record.value)
    said = f"{utc(record.wall_s)} {'ALARM' if came else 'over '} {item.priority} {item.id}"
    line = f"{said}{f' = {value}' if value else ''}: {condition_of(item, record.text)}"
    return plain(line).replace("\n", " ").replace("\t", " ")


class Outbox:
    """Lines for one address, in messages of which at most `per_hour` leave in an hour.

    A token bucket: a message takes a token, and `per_hour` of them come back in an hour. Lines that wait for one leave
    together in the next message, so that a flood of alarms becomes no flood of messages. The first to attend to come
    first, and a critical one waits for no token.
    """

    def __init__(self, per_hour: int) -> None:
        self._per_hour = per_hour
        self._tokens = float(per_hour)
        self._at_s: float | None = None
        self._lines: list[tuple[int, str]] = []

    @property
    def waiting(self) -> int:
        """Return the number of lines that have not left."""
        return len(self._lines)

    def add(self, lines: Sequence[str], rank: int = len(PRIORITIES) - 1) -> None:
        """Add lines of the priority `rank`, 0 for a critical one, in order."""
        self._lines = sorted([*self._lines, *((rank, line) for line in lines)], key=lambda entry: entry[0])

    def due(self, now_s: float, *, last: bool = False) -> tuple[str, ...]:
        """Return the lines of the message that may leave at `now_s`, s of any steady clock; none where none may.

        The `last` message of a run may leave at any time, and critical lines may.
        """
        passed_s = 0.0 if self._at_s is None else max(0.0, now_s - self._at_s)
        self._at_s = now_s
        self._tokens = min(float(self._per_hour), self._tokens + passed_s * self._per_hour / HOUR_S)
        free = last or self._tokens >= 1.0 - 1e-9
        return tuple(line for rank, line in self._lines if free or rank == 0)

    def sent(self, count: int) -> None:
        """Take note that a message with the first `count` lines has left."""
        self._tokens = max(0.0, self._tokens - 1.0)
        del self._lines[:count]


def message(lines: Sequence[str]) -> str:
    """Return the body of a message: the first lines, and how many more there are."""
    more = len(lines) - MOST_LINES
    return "\n".join([*lines[:MOST_LINES], *([f"and {more} more, see `hil alarms`"] if more > 0 else [])])
