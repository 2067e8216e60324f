"""Watch of a test on a run: it gets the values of each tick and may trip the run, and its defects cannot.

A trip goes the way of every alarm: the interlocks latch it on the next tick. A watch that fails is taken off, and the
run goes on; neither its outputs nor the way to their safe values depend on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from hil.run.interlocks.conditions import TickValues


class Watch(Protocol):
    """Observer of the ticks of a run, of those on which the profile goes on and of those on which it stands."""

    def tick(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> str | None:
        """Take the values of a tick at `profile_s`, s of profile time; return why the run has to trip, or None.

        `values` (k,) and their `quality` (k,) are in the order and units of the journal's signals.
        """

    def standing(
        self, profile_s: float, values: Sequence[float], quality: Sequence[int], as_profile: bool
    ) -> str | None:
        """Take the values of a tick on which the profile stands: the run is held, paused, suspended or restored.

        `as_profile` is True where the outputs are those of the profile, and not at their safe values or those of a
        thermal restore.
        """


class GuardedWatch:
    """Watch whose errors are noted by `note` instead of raised. It is a condition of the interlocks."""

    def __init__(self, watch: Watch, note: Callable[[str, str], None]) -> None:
        self._watch: Watch | None = watch
        self._note = note
        self._violation: str | None = None

    def tick(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> None:
        """Hand a tick to the watch."""
        self._hand(lambda watch: watch.tick(profile_s, values, quality))

    def standing(self, profile_s: float, values: Sequence[float], quality: Sequence[int], as_profile: bool) -> None:
        """Hand a tick on which the profile stands to the watch."""
        self._hand(lambda watch: watch.standing(profile_s, values, quality, as_profile))

    def _hand(self, judged: Callable[[Watch], str | None]) -> None:
        if self._watch is None:
            return
        try:
            self._violation = judged(self._watch)
        except Exception as error:
            self._watch = None
            self._note(
                "WARN",
                f"the live judgement of the test ended ({type(error).__name__}: {error}), and trips nothing any more; "
                "the verdict is made from the journal at the end",
            )

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation of the tick before, once: a trip can be acknowledged when its cause is gone."""
        violation, self._violation = self._violation, None
        return violation
