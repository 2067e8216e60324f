"""Batches of a review: new rows of a journal as columns of entities. Plain data, independent of Rerun.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.review.batches.collector import BatchCollector
    from hil.review.batches.columns import Estimates, ReviewBatch, Rows, States, Texts, merged
    from hil.review.batches.thinning import GROUP, needed_rows

__all__ = ["GROUP", "BatchCollector", "Estimates", "ReviewBatch", "Rows", "States", "Texts", "merged", "needed_rows"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "collector": ("BatchCollector",),
        "columns": (
            "ReviewBatch",
            "Estimates",
            "Rows",
            "States",
            "Texts",
            "merged",
        ),
        "thinning": (
            "GROUP",
            "needed_rows",
        ),
    },
)
