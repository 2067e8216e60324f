"""Signals to a run, Ctrl-C and others: none of them skips making the rig safe."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator, Mapping
from functools import partial

from hil.run.engine.engine import Engine

_REASONS = {
    signal.SIGINT: "stopped by the operator (Ctrl-C)",
    signal.SIGTERM: "stopped by SIGTERM",
    signal.SIGQUIT: "stopped by the operator (SIGQUIT)",
    signal.SIGHUP: "stopped because the terminal went away (SIGHUP)",
    # By themselves these would end the process at once, and nothing means them.
    **{
        number: f"stopped by {number.name}"
        for number in (
            signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF, signal.SIGXCPU,
            signal.SIGXFSZ, signal.SIGIO, signal.SIGPWR,
        )
    },
}  # fmt: skip


@contextlib.contextmanager
def stopping(engine: Engine) -> Iterator[None]:
    """Have Ctrl-C, Ctrl-backslash, SIGTERM and a lost terminal stop the engine; a second one shortens its waits."""
    with _handled({number: partial(engine.request_stop, reason) for number, reason in _REASONS.items()}):
        yield


@contextlib.contextmanager
def interrupted(callback: Callable[[], None]) -> Iterator[None]:
    """Have Ctrl-C and SIGTERM call `callback`: derived files of a run must not be lost to an impatient operator."""
    with _handled({signal.SIGINT: callback, signal.SIGTERM: callback}):
        yield


@contextlib.contextmanager
def _handled(handlers: Mapping[signal.Signals, Callable[[], None]]) -> Iterator[None]:
    loop = asyncio.get_running_loop()
    for number, handler in handlers.items():
        loop.add_signal_handler(number, handler)
    try:
        yield
    finally:
        for number in handlers:
            loop.remove_signal_handler(number)
