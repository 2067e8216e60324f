"""Export of a twin as an FMU for co-simulation (FMI 2.0).

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.export.fmu.archive import ExportedTwin, export_twin

__all__ = ["ExportedTwin", "export_twin"]

__getattr__, __dir__ = lazy_names(__name__, {"archive": ("ExportedTwin", "export_twin")})
