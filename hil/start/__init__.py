"""Course from a register table to a diagnosis: questions, commands, answers that are kept.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.start.errors import StartError, StopRequest
    from hil.start.session import StartRequest, start
    from hil.start.store import read_answers

__all__ = ["StartError", "StartRequest", "StopRequest", "read_answers", "start"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "errors": ("StartError", "StopRequest"),
        "session": ("StartRequest", "start"),
        "store": ("read_answers",),
    },
)
