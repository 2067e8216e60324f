"""Output queue: messages for a person, written by a thread that may block, fail or fall behind.

A terminal can be stopped (Ctrl-S), a pipe can lose its reader, a viewer can hang. None of these may delay a tick or the
safing of the rig. The event loop therefore writes to none of them, but puts a call into this queue.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

LONGEST = 1000
"""Most calls that wait. Further ones are dropped: the operator of a stopped output does not see them anyway."""
FLUSH_WITHIN_S = 2.0
"""Longest wait for the output at the end, s."""


class OutputQueue:
    """Bounded queue of calls and the thread that makes them in order. `put` never blocks and never raises."""

    def __init__(self, name: str = "output") -> None:
        self.dropped = 0
        self._queue: queue.Queue[tuple[Callable[..., Any], tuple[Any, ...]] | None] = queue.Queue(LONGEST)
        self._broken = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def put(self, call: Callable[..., Any], *arguments: Any) -> None:
        """Queue `call(*arguments)` for the thread; drop it where the queue is full."""
        try:
            self._queue.put_nowait((call, arguments))
        except queue.Full:
            self.dropped += 1

    def wrapped(self, call: Callable[..., Any]) -> Callable[..., None]:
        """Return a function that queues `call` with its arguments."""

        def put(*arguments: Any) -> None:
            self.put(call, *arguments)

        return put

    def close(self, within_s: float) -> bool:
        """Wait until everything is written, `within_s` seconds at most; return True if the thread has ended."""
        end = time.monotonic() + within_s
        while self._thread.is_alive():
            try:
                self._queue.put(None, timeout=0.05)
                break
            except queue.Full:
                if time.monotonic() > end:
                    break
        self._thread.join(max(end - time.monotonic(), 0.0))
        return not self._thread.is_alive()

    def _work(self) -> None:
        while (item := self._queue.get()) is not None:
            if self._broken:
                continue
            call, arguments = item
            try:
                call(*arguments)
            except OSError:
                self._broken = True  # a pipe without a reader, a terminal that went away
            except SystemExit:
                self._broken = True  # rich raises it on a broken pipe
            except BaseException:
                self.dropped += 1


class QueuedLog(logging.Handler):
    """Log handler that writes through an output queue: the terminal of a log may be stopped, too."""

    def __init__(self, output: OutputQueue, write: Callable[[str], None]) -> None:
        super().__init__(logging.ERROR)
        self._output = output
        self._write = write

    def emit(self, record: logging.LogRecord) -> None:
        """Queue the first line of a record with its error."""
        error = record.exc_info[1] if record.exc_info else None
        line = next(iter(record.getMessage().splitlines()), "") + (f": {error}" if error is not None else "")
        self._output.put(self._write, line)


@contextlib.contextmanager
def queued_output(
    observer: Callable[..., None] | None, announce: Callable[[str], None]
) -> Iterator[tuple[Callable[..., None] | None, Callable[[str], None]]]:
    """Yield both calls through one queue, which also takes log records and errors of the event loop.

    At the end the queue is written, within `FLUSH_WITHIN_S`.
    """
    output = OutputQueue()
    queued = output.wrapped(announce)
    handler = QueuedLog(output, announce)
    root = logging.getLogger()
    root.addHandler(handler)
    hooks = threading.excepthook, sys.unraisablehook
    # Python prints errors of other threads and of destructors on the terminal, too.
    threading.excepthook = lambda error: queued(
        f"{_name(error.thread)} ended: {error.exc_type.__name__}: {error.exc_value}"
    )
    sys.unraisablehook = lambda error: queued(f"{error.err_msg or 'ignored'}: {error.exc_value}")
    try:
        yield None if observer is None else output.wrapped(observer), queued
    finally:
        threading.excepthook, sys.unraisablehook = hooks
        output.close(FLUSH_WITHIN_S)
        root.removeHandler(handler)


def _name(thread: threading.Thread | None) -> str:
    return "a thread" if thread is None else f"the thread {thread.name}"
