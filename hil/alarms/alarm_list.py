"""Alarm list of a run: changes of conditions and acts of operators, folded by the state table. No input or output."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

from hil.alarms.definitions import AlarmDefinition
from hil.alarms.states import SHELVED, WAITING, AlarmEvent, AlarmState, next_alarm_state

ActName = Literal["acknowledge", "shelve", "unshelve"]
LATEST_S = 8e9
"""Latest time of a change or an act, s since 1970: the year 2223."""
LONGEST_SHELVING_S = 7 * 86400.0
"""Longest time that an alarm may be shelved at once, s: a longer one is one that nobody watches."""


@dataclass(frozen=True, slots=True)
class Change:
    """Condition of the alarm `id` that comes (`active`) or goes at `tick`: `time_s` of rig time, `wall_s` since 1970.

    `value` is what the condition compares, NaN where it compares none; `text` is a sentence of the run about it.
    """

    tick: int
    time_s: float
    wall_s: float
    id: str
    active: bool
    value: float = math.nan
    text: str = ""


@dataclass(frozen=True, slots=True)
class Act:
    """Act of an operator on the alarm `id` at `wall_s`, s since 1970, who had seen the run up to `tick`.

    `seen` is the number of its changes that were known then, -1 for all up to `tick`: some are written after rows of
    later ticks. A shelving ends at `until_s`, s since 1970.
    """

    name: ActName
    id: str
    tick: int
    wall_s: float
    by: str
    reason: str = ""
    until_s: float = math.nan
    seen: int = -1


@dataclass(slots=True)
class AlarmStatus:
    """Present state of one alarm; `time_s`, `wall_s`, `value` and `text` are those of the last raise, NaN for none."""

    definition: AlarmDefinition
    state: AlarmState = AlarmState.NORMAL
    time_s: float = math.nan
    wall_s: float = math.nan
    value: float = math.nan
    text: str = ""
    count: int = 0
    by: str = ""
    reason: str = ""
    until_s: float = math.nan


@dataclass(frozen=True, slots=True)
class AlarmRecord:
    """Transition of one alarm: `wall_s` is when, `by` an operator or empty, `value` and `text` those of the change."""

    wall_s: float
    time_s: float
    id: str
    event: AlarmEvent
    source: AlarmState
    target: AlarmState
    tick: int
    by: str = ""
    reason: str = ""
    value: float = math.nan
    text: str = ""

    @property
    def time(self) -> str:
        """Return the time as ISO 8601 in UTC."""
        return utc(self.wall_s)


@dataclass(slots=True)
class AlarmList:
    """Alarms of a run by id, and their transitions in order."""

    statuses: dict[str, AlarmStatus]
    records: list[AlarmRecord] = field(default_factory=list)

    def standing(self) -> list[AlarmStatus]:
        """Return the alarms that are not normal: those that wait for an operator first, then by priority and time."""
        found = [item for item in self.statuses.values() if item.state is not AlarmState.NORMAL]
        return sorted(
            found,
            key=lambda a: (a.state in SHELVED, a.state not in WAITING, a.definition.rank, -_finite(a.wall_s)),
        )


def _finite(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def fold(
    definitions: Iterable[AlarmDefinition], changes: Sequence[Change], acts: Sequence[Act], now_s: float
) -> AlarmList:
    """Return the alarm list after `changes` and `acts`, at `now_s`, s since 1970.

    An act comes after the changes of its alarm that its operator had seen, and shelvings end by the wall clock. An act
    that the table does not admit at its place is left out, as is what concerns an alarm that is not defined.

    Parameters
    ----------
    definitions
        Alarms of the run.
    changes
        Changes of conditions, those of one alarm in the order in which they were written.
    acts
        Acts in the order in which they were made.
    now_s
        Time at which the list is asked for.
    """
    statuses = {item.id: AlarmStatus(item) for item in definitions}
    book = _Book(AlarmList(statuses))
    changes_of: dict[str, list[Change]] = {name: [] for name in statuses}
    acts_of: dict[str, list[Act]] = {name: [] for name in statuses}
    for change in changes:
        if change.id in statuses:
            changes_of[change.id].append(change)
    for act in acts:
        if act.id in statuses:
            acts_of[act.id].append(act)
    for name, status in statuses.items():
        for item in _merged(changes_of[name], acts_of[name]):
            book.end_shelving(status, item.wall_s)
            if isinstance(item, Change):
                book.change(item)
            else:
                book.act(item)
        book.end_shelving(status, now_s)
    book.kept.records = _by_time(book.kept.records)
    return book.kept


def _merged(changes: list[Change], acts: list[Act]) -> Iterator[Change | Act]:
    """Yield changes and acts of one alarm, each act after the changes that its operator had seen."""
    done = 0
    for act in acts:
        seen = sum(change.tick <= act.tick for change in changes)
        known = max(done, seen if act.seen < 0 else min(act.seen, seen))
        yield from changes[done:known]
        done = known
        yield act
    yield from changes[done:]


def _by_time(records: list[AlarmRecord]) -> list[AlarmRecord]:
    """Return records by time; those of one alarm stay in their order, whatever the wall clock did."""
    latest: dict[str, float] = {}
    keys = []
    for record in records:
        before = latest.get(record.id, -math.inf)
        latest[record.id] = max(before, record.wall_s) if math.isfinite(record.wall_s) else before
        keys.append(latest[record.id])
    return [records[k] for k in sorted(range(len(records)), key=keys.__getitem__)]


class _Book:
    """Alarm list while it is folded."""

    def __init__(self, kept: AlarmList) -> None:
        self.kept = kept

    def change(self, item: Change) -> None:
        status = self.kept.statuses[item.id]
        event = AlarmEvent.RAISE if item.active else AlarmEvent.CLEAR
        if not self._take(status, event, item.wall_s, item.time_s, item.tick, value=item.value, text=item.text):
            return
        if item.active:
            status.time_s, status.wall_s, status.value = item.time_s, item.wall_s, item.value
            status.count += 1
        if item.active or item.text:
            status.text = item.text

    def act(self, item: Act) -> None:
        status, event = self.kept.statuses[item.id], AlarmEvent(item.name)
        if not self._take(status, event, item.wall_s, status.time_s, item.tick, by=item.by, reason=item.reason):
            return
        status.by, status.reason = item.by, item.reason
        if event is AlarmEvent.SHELVE:
            status.until_s = item.until_s

    def end_shelving(self, status: AlarmStatus, now_s: float) -> None:
        """End the shelving of an alarm if it is over at `now_s`; none ends at a time that is not known."""
        if status.state in SHELVED and math.isfinite(now_s) and not status.until_s > now_s:
            self._take(status, AlarmEvent.UNSHELVE, status.until_s, status.time_s, -1, reason="the shelving has ended")

    def _take(
        self,
        status: AlarmStatus,
        event: AlarmEvent,
        wall_s: float,
        time_s: float,
        tick: int,
        **said: str | float,
    ) -> bool:
        """Make a transition of the table; return False where it has none."""
        target = next_alarm_state(status.state, event, latching=status.definition.latch)
        if target is None:
            return False
        made = AlarmRecord(wall_s, time_s, status.definition.id, event, status.state, target, tick, **said)  # type: ignore[arg-type]
        self.kept.records.append(made)
        status.state = target
        if event is AlarmEvent.UNSHELVE:
            status.until_s = math.nan
        return True


def refusal(status: AlarmStatus, name: ActName) -> str | None:
    """Return why an alarm does not admit an act, as a sentence, or None."""
    if next_alarm_state(status.state, AlarmEvent(name), latching=status.definition.latch) is not None:
        return None
    said = f"{status.definition.id} is {status.state}"
    if name == "shelve":
        return f"{said} and only waits to be acknowledged; acknowledge it instead of shelving it"
    if name == "unshelve":
        return f"{said}, so there is no shelving to end"
    if status.state in SHELVED:
        return f"{said}; end the shelving first"
    return f"{said}, so there is nothing to acknowledge"


def utc(wall_s: float) -> str:
    """Return a time as ISO 8601 in UTC, empty for NaN and for one that no clock shows (before 1970, after 2223)."""
    if not 0.0 <= wall_s <= LATEST_S:
        return ""
    return datetime.datetime.fromtimestamp(wall_s, datetime.UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
