"""Mutated files, replies and frames against their readers.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from hil.lazy_names import lazy_names

__all__ = ["tables", "wire"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": (
            "tables",
            "wire",
        ),
    },
)
