"""Files and text from untrusted sources: atomic writing, names, limits, escaping.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.files.arrow import look_for_pandas, spare_pandas
    from hil.files.atomic import replacing, require_writable
    from hil.files.estimates import estimate_text
    from hil.files.folder_check import read_json, require_plain, require_unshared
    from hil.files.held_folder import held, replacing_all, require_complete, take_lock
    from hil.files.html import Html, document, element, image, joined, plot_data, table
    from hil.files.json_text import parse_json
    from hil.files.limits import TEXT_COPIES, Failure, read_parquet, require_cells, require_columns, require_size
    from hil.files.line_file import append_line, read_lines
    from hil.files.names import (
        ENDINGS,
        LONGEST_DATABASE_PATH,
        accept_any_name,
        connect_read_only,
        longest_name,
        on_terminal,
        printable,
        safe_file_name,
        utf8_path,
    )
    from hil.files.text import is_blank, plain

__all__ = [
    "ENDINGS",
    "LONGEST_DATABASE_PATH",
    "TEXT_COPIES",
    "Failure",
    "Html",
    "accept_any_name",
    "append_line",
    "connect_read_only",
    "document",
    "element",
    "estimate_text",
    "held",
    "image",
    "is_blank",
    "joined",
    "longest_name",
    "look_for_pandas",
    "on_terminal",
    "parse_json",
    "plain",
    "plot_data",
    "printable",
    "read_json",
    "read_lines",
    "read_parquet",
    "replacing",
    "replacing_all",
    "require_cells",
    "require_columns",
    "require_complete",
    "require_plain",
    "require_size",
    "require_unshared",
    "require_writable",
    "safe_file_name",
    "spare_pandas",
    "table",
    "take_lock",
    "utf8_path",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "arrow": ("look_for_pandas", "spare_pandas"),
        "atomic": ("replacing", "require_writable"),
        "estimates": ("estimate_text",),
        "folder_check": (
            "read_json",
            "require_plain",
            "require_unshared",
        ),
        "held_folder": (
            "held",
            "replacing_all",
            "require_complete",
            "take_lock",
        ),
        "html": (
            "Html",
            "document",
            "element",
            "image",
            "joined",
            "plot_data",
            "table",
        ),
        "json_text": ("parse_json",),
        "limits": (
            "Failure",
            "TEXT_COPIES",
            "read_parquet",
            "require_cells",
            "require_columns",
            "require_size",
        ),
        "line_file": ("append_line", "read_lines"),
        "names": (
            "ENDINGS",
            "LONGEST_DATABASE_PATH",
            "accept_any_name",
            "connect_read_only",
            "longest_name",
            "on_terminal",
            "printable",
            "safe_file_name",
            "utf8_path",
        ),
        "text": ("is_blank", "plain"),
    },
)
