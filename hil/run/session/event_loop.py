"""Event loop of a command that runs a session: its result survives a loop that cannot be closed in order.

A machine without memory, threads or descriptors lets the end of a loop fail: it starts a thread to end other threads.
By then the rig is safe and the run recorded, so that nothing but the last words could be lost.
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


def finished(session: Coroutine[Any, Any, T], *, until_exit: bool = False) -> T:
    """Return the result of `session`; raises what it raises, and nothing else.

    With `until_exit` this process ends with the command: what destructors and threads complain of from then on helps
    nobody, and is not printed.
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
