"""Judgement of a test while its run goes on.

A limit that one value can break is judged on every tick, one with times of its own when these are over. A limit on
every value without times is also judged while the profile stands. All others wait for the journal at the end of the
run, as do limits on twins and on the diagnosis. The final verdict is always made from the journal.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence

import numpy as np

from drivers.signals import Signal
from hil.testing.bound_limits import BoundLimit
from hil.testing.judgement import Judgement, holds_always, is_above, judge, shown
from hil.testing.limits import Bound, Compared, Follows, NoEffect, NoTrip, Settles, Trips, TwinError
from hil.testing.plan import Plan
from hil.testing.run_data import RunData
from hil.testing.terminal import judgement_line

_OPEN = 1e-6
"""Part of a second by which times may differ and still be the same."""


class LiveTest:
    """Watch of a run (`hil.run.interlocks.Watch`) that judges the limits of a plan; `announce` gets a line for each.

    `period_s` is the length of a tick, s.
    """

    def __init__(
        self,
        plan: Plan,
        limits: Sequence[BoundLimit],
        signals: Sequence[Signal],
        period_s: float,
        announce: Callable[[str], None],
    ) -> None:
        self._plan, self._period_s, self._announce = plan, period_s, announce
        self._index = {signal.column: position for position, signal in enumerate(signals)}
        self._quick = [_Quick(limit, self._index, period_s) for limit in limits if _Quick.takes(limit)]
        self._windowed = [limit for limit in limits if _has_window(limit)]
        columns = {name for limit in self._windowed for name in _columns(limit)}
        self._store = {name: array("d") for name in sorted(columns)}
        self._times, self._parts = array("d"), array("q")
        self._part, self._stood = 0, False
        self._failed: set[str] = set()

    def tick(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> str | None:
        """Take a tick at `profile_s`, s, with `values` (k,) and their `quality` (k,); return why to trip, or None."""
        self._part, self._stood = self._part + self._stood, False
        reasons = self._broken(profile_s, [(quick, quick.tick(profile_s, values, quality)) for quick in self._quick])
        if self._windowed:
            reasons += self._windows(profile_s, values, quality)
        return reasons[0] if reasons else None

    def standing(
        self, profile_s: float, values: Sequence[float], quality: Sequence[int], as_profile: bool
    ) -> str | None:
        """Take a tick on which the profile stands at `profile_s`, s; return why to trip, or None.

        `as_profile` is False where the outputs are not those of the profile: then only upper ends of limits count.
        """
        self._stood = True
        always = [quick for quick in self._quick if holds_always(quick.bound)]
        found = [(quick, quick.standing(values, quality, as_profile)) for quick in always]
        reasons = self._broken(profile_s, found)
        return reasons[0] if reasons else None

    def _broken(self, profile_s: float, found: Sequence[tuple[_Quick, str | None]]) -> list[str]:
        """Announce the limits that are broken for the first time, and return the reasons to trip."""
        reasons = []
        for quick, said in found:
            if said is None:
                continue
            limit = quick.bound.limit
            if limit.id not in self._failed:
                self._show(profile_s, Judgement(limit, "fail", said))
            if self._plan.trips(limit):
                reasons.append(f"test {self._plan.id}: limit {limit.id} ({limit.text}) failed: {said}")
        return reasons

    def _windows(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> list[str]:
        """Keep the tick for the limits whose times have begun, and judge those whose times are over."""
        if any(_begins_s(limit) <= profile_s for limit in self._windowed):
            self._times.append(profile_s)
            self._parts.append(self._part)
            for name, kept in self._store.items():
                index = self._index[name]
                kept.append(values[index] if quality[index] == 0 else math.nan)
        over = [limit for limit in self._windowed if limit.to_s <= profile_s + _OPEN]
        if not over:
            return []
        self._windowed = [limit for limit in self._windowed if limit not in over]
        data = RunData(
            np.array(self._times),
            {name: np.array(kept) for name, kept in self._store.items()},
            (),
            self._period_s,
            math.inf,
            parts=np.array(self._parts),
        )
        reasons = []
        for limit in over:
            judged = judge(limit, data)
            # A resumed run has not seen all of the time: the journal knows.
            if judged.limit.id in self._failed or judged.verdict == "inconclusive":
                continue
            self._show(profile_s, judged)
            if judged.verdict == "fail" and self._plan.trips(judged.limit):
                reasons.append(
                    f"test {self._plan.id}: limit {limit.limit.id} ({limit.limit.text}) failed: {judged.text}"
                )
        if not any(_begins_s(limit) <= profile_s for limit in self._windowed):
            self._times, self._parts = array("d"), array("q")
            self._store = {name: array("d") for name in self._store}
        return reasons

    def _show(self, profile_s: float, judged: Judgement) -> None:
        if judged.verdict == "fail":
            self._failed.add(judged.limit.id)
        self._announce(f"at {profile_s:.0f} s of the profile  {judgement_line(judged)}")


def _has_window(bound: BoundLimit) -> bool:
    """Return True for a limit on signals with times of its own."""
    window = bound.limit.sentence.window
    on_signals = not isinstance(bound.statement, TwinError | NoEffect | NoTrip | Trips)
    return on_signals and (window.from_s is not None or window.to_s is not None)


def _columns(bound: BoundLimit) -> list[str]:
    return [name for name in (*bound.columns, bound.condition, bound.setpoint) if name is not None]


def _begins_s(bound: BoundLimit) -> float:
    """Return the profile time from which a limit needs values, s: a reading also needs those of its set-point."""
    said = bound.statement
    before_s = said.constant_s or 0.0 if isinstance(said, Follows) else 0.0
    return bound.from_s - before_s - _OPEN


class _Quick:
    """Limit that a single value, or the time beyond a threshold so far, can break."""

    def __init__(self, bound: BoundLimit, index: dict[str, int], period_s: float) -> None:
        said = bound.statement
        assert isinstance(said, Compared)
        self.bound = bound
        self._said, self._period_s = said, period_s
        self._at = [(column, index[column]) for column in bound.columns]
        self._condition = None if bound.condition is None else index[bound.condition]
        self._beyond = dict.fromkeys(bound.columns, 0)
        self._last_s = math.nan

    @staticmethod
    def takes(bound: BoundLimit) -> bool:
        """Return True for a limit whose failure shows before its time is over."""
        said = bound.statement
        if not isinstance(said, Compared) or isinstance(said, Settles):
            return False
        upper = said.bound.operator.startswith("<")
        grows = {"value": True, "max": upper, "min": not upper and said.bound.upper is None}
        grows |= {"time": upper, "longest": upper}
        return grows.get(said.measure, False)

    def tick(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> str | None:
        """Return the violation on this tick as a sentence, or None."""
        is_next = abs(profile_s - self._last_s - self._period_s) < 0.5 * self._period_s
        self._last_s = profile_s
        is_inside = self.bound.from_s - _OPEN <= profile_s <= self.bound.to_s + _OPEN
        counts = is_inside and self._counts(values, quality)
        for column, index in self._at:
            said = self._violation(column, values[index], counts and quality[index] == 0, is_next)
            if said is not None:
                return said if len(self._at) == 1 else f"{column}: {said}"
        return None

    def standing(self, values: Sequence[float], quality: Sequence[int], as_profile: bool) -> str | None:
        """Return the violation on a tick on which the profile stands as a sentence, or None."""
        if not self._counts(values, quality):
            return None
        for column, index in self._at:
            value = values[index]
            if quality[index] != 0 or holds(value, self._said.bound):
                continue
            if as_profile or is_above(np.array([value]), self._said.bound)[0]:
                said = f"{shown(value, self.bound.unit)} while the profile stands, the limit is {self._said.bound}"
                return said if len(self._at) == 1 else f"{column}: {said}"
        return None

    def _counts(self, values: Sequence[float], quality: Sequence[int]) -> bool:
        """Return True where the condition of the limit is fulfilled, or it has none."""
        if self._condition is None or self.bound.while_ is None:
            return True
        return quality[self._condition] == 0 and holds(values[self._condition], self.bound.while_)

    def _violation(self, column: str, value: float, is_known: bool, is_next: bool) -> str | None:
        """Return the violation by the value of a tick; `is_next` is False for one after ticks that are missing.

        Times are counted as in the judgement of the journal: in ticks whose value is known and beyond, and the longest
        one in ticks that follow each other.
        """
        said, threshold = self._said, self._said.threshold
        if threshold is None:
            is_kept = not is_known or holds(value, said.bound)
            return None if is_kept else f"{shown(value, self.bound.unit)}, the limit is {said.bound}"
        is_beyond = is_known and holds(value, threshold)
        if said.measure == "longest" and not (is_beyond and is_next):
            self._beyond[column] = 0
        self._beyond[column] += is_beyond
        beyond_s = self._beyond[column] * self._period_s
        if not is_known or holds(beyond_s, said.bound):
            return None
        return f"{beyond_s:g} s so far, the limit is {said.bound}"


def holds(value: float, bound: Bound) -> bool:
    """Return True for a value within a bound; NaN is within none."""
    number = bound.amount.number
    if bound.upper is not None:
        return number <= value <= bound.upper.number
    if bound.operator == "<":
        return value < number
    if bound.operator == "<=":
        return value <= number
    return value > number if bound.operator == ">" else value >= number
