"""Exports for other tools: a run as a file of measured data, a twin as an FMU.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.export.content import ExportError
    from hil.export.fmu import ExportedTwin, export_twin
    from hil.export.run_export import SUFFIX, export_run

__all__ = ["SUFFIX", "ExportError", "ExportedTwin", "export_run", "export_twin"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "content": ("ExportError",),
        "fmu": ("ExportedTwin", "export_twin"),
        "run_export": ("SUFFIX", "export_run"),
    },
)
