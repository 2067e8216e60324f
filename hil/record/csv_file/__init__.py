"""CSV files to named columns of text: encoding, dialect, annotations, LabVIEW's headers, repeated headings.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.record.csv_file.annotated import is_annotated
    from hil.record.csv_file.dialect import DialectError, find_dialect
    from hil.record.csv_file.encodings import EncodingError, beginning_of, utf8
    from hil.record.csv_file.labview import is_labview
    from hil.record.csv_file.labview_exports import is_waveforms
    from hil.record.csv_file.table import read_csv

__all__ = [
    "DialectError",
    "EncodingError",
    "beginning_of",
    "find_dialect",
    "is_annotated",
    "is_labview",
    "is_waveforms",
    "read_csv",
    "utf8",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "annotated": ("is_annotated",),
        "dialect": (
            "DialectError",
            "find_dialect",
        ),
        "encodings": (
            "EncodingError",
            "beginning_of",
            "utf8",
        ),
        "labview": ("is_labview",),
        "labview_exports": ("is_waveforms",),
        "table": ("read_csv",),
    },
)
