"""Layouts of a table other than a column for each signal: readings in rows, tables side by side, several sources, tags.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.record.layouts.long_format import VALUES, one_column_a_series
    from hil.record.layouts.side_by_side import one_below_the_other
    from hil.record.layouts.sources import one_column_a_source
    from hil.record.layouts.tags import tag_samples

__all__ = ["VALUES", "one_below_the_other", "one_column_a_series", "one_column_a_source", "tag_samples"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "long_format": ("VALUES", "one_column_a_series"),
        "side_by_side": ("one_below_the_other",),
        "sources": ("one_column_a_source",),
        "tags": ("tag_samples",),
    },
)
