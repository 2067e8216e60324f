"""Watch of a test on a run: it gets the values of each tick and may trip the run, and its defects cannot.

A trip goes the way of every alarm: the interlocks latch it on the next tick. A watch that fails is taken off, and the
run goes on; neither its outputs nor the way to their safe values depend on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from hil.run.interlocks.conditions import TickValues


class Watch(Protocol):
    """Observer of the ticks on which the profile goes on."""

    def tick(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> str | None:
        """Take the values of a tick at `profile_s`, s of profile time; return why the run has to trip, or None.

        `values` (k,) and their `quality` (k,) are in the order and units of the journal's signals.
        """


class GuardedWatch:
    """Watch whose errors are noted by `note` instead of raised. It is a condition of the interlocks."""

    def __init__(self, watch: Watch, note: Callable[[str, str], None]) -> None:
        self._watch: Watch | None = watch
        self._note = note
        self._violation: str | None = None

    def tick(self, profile_s: float, values: Sequence[float], quality: Sequence[int]) -> None:
        """Hand a tick to the watch."""
        if self._watch is None:
            return
        try:
            self._violation = self._watch.tick(profile_s, values, quality)
        except Exception as error:
            self._watch = None
            self._note(
                "WARN",
                f"the live judgement of the test ended ({type(error).__name__}: {error}), and trips nothing any more; "
                "the verdict is made from the journal at the end",
            )

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Return the violation of the tick before, once: a trip can be acknowledged while the profile stands."""
        violation, self._violation = self._violation, None
        return violation
