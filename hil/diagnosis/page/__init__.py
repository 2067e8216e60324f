"""Page `diagnosis.html` and its figures.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.diagnosis.page.document import PAGE_STYLE, page, write_page
    from hil.diagnosis.page.figure_style import STYLE

__all__ = ["PAGE_STYLE", "STYLE", "page", "write_page"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "document": (
            "PAGE_STYLE",
            "page",
            "write_page",
        ),
        "figure_style": ("STYLE",),
    },
)
