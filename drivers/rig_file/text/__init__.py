"""Text of a file that a person writes: regular files, encodings, the line of each key.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.rig_file.text.bounded_toml import parse_toml
    from drivers.rig_file.text.encodings import decoded
    from drivers.rig_file.text.regular_file import MOST_DESCRIPTION, read_regular, refuse_irregular
    from drivers.rig_file.text.toml_lines import line_of, tables_of


__all__ = ["MOST_DESCRIPTION", "decoded", "line_of", "parse_toml", "read_regular", "refuse_irregular", "tables_of"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "bounded_toml": ("parse_toml",),
        "encodings": ("decoded",),
        "regular_file": ("MOST_DESCRIPTION", "read_regular", "refuse_irregular"),
        "toml_lines": ("line_of", "tables_of"),
    },
)
