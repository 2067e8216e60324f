"""One processor for processes that take turns.

In lockstep the engine waits for the rig, and the rig for the engine: only one of them works at any moment. Spread over
processors, each finds its own asleep at every message, and to wake one takes longer than the work. A system without
affinities is left as it is.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from pathlib import Path


@contextlib.contextmanager
def taking_turns(pids: Iterable[int]) -> Iterator[None]:
    """Keep this process and those of `pids` on one processor within the block.

    Processes that were started before, such as the calibrators, have the others to themselves; one that is started
    within the block shares the one. Concurrent runs choose by their process ids.
    """
    before = {pid: _affinity(pid) for pid in (os.getpid(), *pids)}
    usable = sorted(before[os.getpid()])
    if len(usable) < 2:
        yield
        return
    one = {usable[os.getpid() % len(usable)]}
    for pid in before:
        _keep(pid, one)
    try:
        yield
    finally:
        for pid, processors in before.items():
            _keep(pid, processors)


def _affinity(pid: int) -> set[int]:
    """Return the processors that a process may use; empty where it has ended or the system does not say."""
    with contextlib.suppress(AttributeError, OSError):
        return set(os.sched_getaffinity(pid))
    return set()


def _keep(pid: int, processors: set[int]) -> None:
    """Allow the threads of a process these processors alone; one that has ended, or that may not be changed, stays."""
    with contextlib.suppress(AttributeError, OSError):
        for thread in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError):
                os.sched_setaffinity(int(thread.name), processors)
