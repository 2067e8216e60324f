"""Stop of long work: at its time limit or at a signal, with the current step completed."""

from __future__ import annotations

import signal
import threading
import time
from types import FrameType, TracebackType
from typing import Any, Self

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Stop:
    """Asked between steps, by `over`. The first signal ends work in order, a second one at once.

    `interrupted`: whether there was a signal.

    Parameters
    ----------
    minutes
        From now; None for no limit.
    """

    def __init__(self, minutes: float | None = None) -> None:
        self._until = None if minutes is None else time.monotonic() + 60.0 * minutes
        self.interrupted = False
        self._before: dict[signal.Signals, Any] = {}

    @property
    def over(self) -> bool:
        return self.interrupted or (self._until is not None and time.monotonic() >= self._until)

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._asked) for number in SIGNALS}
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._restore()

    def _asked(self, number: int, frame: FrameType | None) -> None:
        self.interrupted = True
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}
