"""Exports for other tools: a run as a file of measured data, a twin as an FMU.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.export.content import ExportError
    from hil.export.run_export import SUFFIX, export_run

__all__ = ["SUFFIX", "ExportError", "export_run"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "content": ("ExportError",),
        "run_export": ("SUFFIX", "export_run"),
    },
)
