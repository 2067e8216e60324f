"""Several runs side by side: list, differences on profile time, overlaid plots, drift of parameters.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.comparison.differences import Comparison, Difference, compare_runs
    from hil.comparison.page import difference_head, difference_row, require_page, write_comparison
    from hil.comparison.summaries import RunSummary, run_summaries

__all__ = [
    "Comparison",
    "Difference",
    "RunSummary",
    "compare_runs",
    "difference_head",
    "difference_row",
    "require_page",
    "run_summaries",
    "write_comparison",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "differences": (
            "Comparison",
            "Difference",
            "compare_runs",
        ),
        "page": (
            "difference_head",
            "difference_row",
            "require_page",
            "write_comparison",
        ),
        "summaries": (
            "RunSummary",
            "run_summaries",
        ),
    },
)
