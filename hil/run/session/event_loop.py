"""Event loop of a command that runs a session: the result survives a loop that cannot be closed.

The end of a loop starts a thread to join other threads. That fails on a machine without memory, threads or descriptors.
At that point the rig is safe and the run is recorded, so that only the last messages could be lost.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import sys
import threading
from collections.abc import Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


def session_result(session: Coroutine[Any, Any, T], *, until_exit: bool = False) -> T:
    """Return the result of `session`; raise its errors, and no others.

    With `until_exit` this process ends with the command: later errors of destructors and threads are not printed.
    """
    runner = asyncio.Runner()
    try:
        return runner.run(session)
    finally:
        if until_exit:
            sys.unraisablehook = lambda ignored: None
            threading.excepthook = lambda ignored: None
            logging.getLogger("asyncio").disabled = True
        with contextlib.suppress(Exception):
            runner.close()
