"""Importer of vendors' register tables.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.importers.vendor_table.headings import names_registers
    from drivers.importers.vendor_table.table import import_csv


__all__ = ["import_csv", "names_registers"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "headings": ("names_registers",),
        "table": ("import_csv",),
    },
)
