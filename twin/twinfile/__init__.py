"""Twin files: TOML text to a validated network and back, and a twin file from a data sheet.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.twinfile.datasheet import from_datasheet
    from twin.twinfile.toml_text import dump, from_tables, is_edited, load, parse, read_text, save, to_tables


__all__ = ["dump", "from_datasheet", "from_tables", "is_edited", "load", "parse", "read_text", "save", "to_tables"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "datasheet": ("from_datasheet",),
        "toml_text": ("dump", "from_tables", "is_edited", "load", "parse", "read_text", "save", "to_tables"),
    },
)
