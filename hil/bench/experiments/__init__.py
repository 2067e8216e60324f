"""Experiments of the paper and public records, with published figures.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.experiments.public_records import FITTED_TEST, TWINS

__all__ = ["FITTED_TEST", "TWINS", "paper", "public_tables", "structure"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": (
            "paper",
            "public_tables",
            "structure",
        ),
        "public_records": (
            "FITTED_TEST",
            "TWINS",
        ),
    },
)
