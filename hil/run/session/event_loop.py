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
    """Return the result of `session`; raise its errors, KeyboardInterrupt where a signal cancelled it, and no others.

    An error in a callback of the loop, which nobody waits for, is told in a line: asyncio itself begins to listen anew
    on a socket that was closed meanwhile, after a lack of descriptors.

    With `until_exit` this process ends with the command: later errors of destructors and threads are not printed.
    """
    runner = asyncio.Runner()
    try:
        runner.get_loop().set_exception_handler(_tell)
        return runner.run(session)
    except asyncio.CancelledError:
        raise KeyboardInterrupt from None  # nothing but a signal cancels a session
    finally:
        if until_exit:
            sys.unraisablehook = lambda ignored: None
            threading.excepthook = lambda ignored: None
            logging.getLogger("asyncio").disabled = True
        with contextlib.suppress(Exception):
            runner.close()


def _tell(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Log an error in a callback of the loop as one line, without its traceback."""
    error = context.get("exception")
    logging.getLogger("asyncio").error("%s%s", context["message"], f": {error}" if error is not None else "")
