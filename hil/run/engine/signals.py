"""Signals to a run: none of them may skip making the rig safe, or cut off the record of an ended run unasked."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from hil.run.engine.engine import Engine
from hil.run.engine.supervisor import SECOND_REQUEST_S

_REASONS = {
    signal.SIGINT: "stopped by the operator (Ctrl-C)",
    signal.SIGTERM: "stopped by SIGTERM",
    signal.SIGQUIT: "stopped by the operator (SIGQUIT)",
    signal.SIGHUP: "stopped because the terminal went away (SIGHUP)",
    # By themselves these would end the process at once, and nothing means them; not every platform has all of them.
    **{
        signal.Signals[name]: f"stopped by {name}"
        for name in (
            "SIGUSR1",
            "SIGUSR2",
            "SIGALRM",
            "SIGVTALRM",
            "SIGPROF",
            "SIGXCPU",
            "SIGXFSZ",
            "SIGIO",
            "SIGPWR",
        )
        if hasattr(signal, name)
    },
}
_IGNORED_AFTER = (signal.SIGINT, signal.SIGTERM, signal.SIGQUIT, signal.SIGHUP)
_SKIPPING = (signal.SIGINT, signal.SIGTERM)


class RunSignals:
    """Signals that end a process, taken over from the beginning of a run to the end of its command.

    Each phase of a run says what a signal does in it. Between two phases a signal does nothing, but the `first` one
    is remembered: a request to end is never lost. A signal is deliberate where none came within `SECOND_REQUEST_S`
    before it: a key that is held down sends many, and they are one request.
    While Python cannot run a handler, signals gather; their number is read from the wake-up descriptor, to which the
    system's handler writes a byte for each. With `until_exit` those that ask for an end are ignored for
    the rest of the process, where nothing comes after the run. A SIGHUP that the process was started to ignore, as by
    nohup, stays ignored: whoever did so wants the run to outlive its terminal.
    """

    def __init__(self, *, until_exit: bool = False) -> None:
        self.first: signal.Signals | None = None
        self.serves_engine = False
        self._until_exit = until_exit
        self._phase: Callable[[signal.Signals, bool], None] | None = None
        self._last_s = -SECOND_REQUEST_S
        self._before: dict[signal.Signals, Any] = {}
        self._holds = False
        self._arrivals: tuple[socket.socket, socket.socket] | None = None

    def __enter__(self) -> RunSignals:
        self._before = {number: signal.getsignal(number) for number in _REASONS}
        return self

    def __exit__(self, *_: object) -> None:
        if not self._holds:
            return
        for number, handler in self._before.items():
            by_default = signal.SIG_DFL if handler is None else handler
            # Python gives handlers of its own up before it ends, and a signal would then kill the process.
            is_ignored = self._until_exit and number in _IGNORED_AFTER
            signal.signal(number, signal.SIG_IGN if is_ignored else by_default)
        signal.set_wakeup_fd(-1)
        for end in self._arrivals or ():
            end.close()
        self._holds, self._arrivals = False, None

    def hold(self) -> None:
        """Take the signals over until this context ends; harmless when repeated, and in a thread, where Python allows
        no handler."""
        if not self._holds and threading.current_thread() is threading.main_thread():
            self._holds, self._arrivals = True, socket.socketpair()
            for end in self._arrivals:
                end.setblocking(False)
            signal.set_wakeup_fd(self._arrivals[1].fileno(), warn_on_full_buffer=False)
            for number in _REASONS:
                if number != signal.SIGHUP or self._before[number] != signal.SIG_IGN:
                    signal.signal(number, self)

    @contextlib.contextmanager
    def phase(self, act: Callable[[signal.Signals, bool], None]) -> Iterator[None]:
        """Call `act` for each signal in the block, with its number and True where it is deliberate."""
        self.hold()
        before, self._phase = self._phase, act
        try:
            yield
        finally:
            self._phase = before

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        arrived = self._arrived()
        is_deliberate = now - self._last_s > SECOND_REQUEST_S and arrived <= 1
        self._last_s = now
        self.first = self.first or signal.Signals(number)
        if self._phase is not None:
            self._phase(signal.Signals(number), is_deliberate)

    def _arrived(self) -> int:
        """Return the number of signals that have come since the last call."""
        if self._arrivals is None:
            return 1
        try:
            return len(self._arrivals[0].recv(4096))
        except BlockingIOError:
            return 0


@contextlib.contextmanager
def cancelling(signals: RunSignals) -> Iterator[None]:
    """Cancel the calling task on a signal in the block, until `stopping` has an engine that can be asked to stop.

    What swallows that cancellation cannot lose the request: the engine is told of it before it heats.
    """
    loop, task = asyncio.get_running_loop(), asyncio.current_task()

    def cancel(number: signal.Signals, is_deliberate: bool) -> None:
        if not signals.serves_engine and task is not None:
            loop.call_soon_threadsafe(task.cancel)

    with signals.phase(cancel):
        yield


@contextlib.contextmanager
def stopping(engine: Engine, signals: RunSignals) -> Iterator[None]:
    """Ask the engine to stop on every signal in the block, and on one that came before; it tells an echo from a second
    request by itself."""
    loop = asyncio.get_running_loop()
    signals.serves_engine = True

    def stop(number: signal.Signals, is_deliberate: bool) -> None:
        loop.call_soon_threadsafe(engine.request_stop, _REASONS[number])

    with signals.phase(stop):
        if signals.first is not None:
            engine.request_stop(_REASONS[signals.first])
        yield


@contextlib.contextmanager
def interrupted(callback: Callable[[], None], signals: RunSignals) -> Iterator[None]:
    """Call `callback` on a deliberate Ctrl-C or SIGTERM in the block: an operator need not wait for what is derived."""
    loop = asyncio.get_running_loop()

    def skip(number: signal.Signals, is_deliberate: bool) -> None:
        if is_deliberate and number in _SKIPPING:
            loop.call_soon_threadsafe(callback)

    with signals.phase(skip):
        yield
