"""Page `diagnosis.html` and its figures.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.diagnosis.page.document import page, write_page

__all__ = ["page", "write_page"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "document": (
            "page",
            "write_page",
        ),
    },
)
