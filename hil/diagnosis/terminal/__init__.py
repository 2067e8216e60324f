"""Report of a diagnosis in the terminal.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.diagnosis.terminal.report import print_diagnosis
    from hil.diagnosis.terminal.table import errors_of, held_out

__all__ = ["errors_of", "held_out", "print_diagnosis"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "report": ("print_diagnosis",),
        "table": (
            "errors_of",
            "held_out",
        ),
    },
)
