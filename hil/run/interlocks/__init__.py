"""Interlocks of a run and the conditions that they watch.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.run.interlocks.conditions import Residuals, TickValues
    from hil.run.interlocks.interlocks import Interlocks, InterlockStatus
    from hil.run.interlocks.watch import GuardedWatch, Watch

__all__ = ["GuardedWatch", "InterlockStatus", "Interlocks", "Residuals", "TickValues", "Watch"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "conditions": (
            "Residuals",
            "TickValues",
        ),
        "interlocks": (
            "InterlockStatus",
            "Interlocks",
        ),
        "watch": (
            "GuardedWatch",
            "Watch",
        ),
    },
)
