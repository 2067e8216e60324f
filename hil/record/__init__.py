"""Records, Parquet or CSV: read, checked, in seconds and the units of their columns.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.record.csv_file import DialectError, beginning_of, find_dialect, is_annotated, is_labview, is_waveforms
    from hil.record.file import foreign_kind, read_cells
    from hil.record.layouts import VALUES, tag_samples
    from hil.record.public import (
        PIPE_TESTS,
        WATER_DENSITY,
        PublicRecord,
        dry_cooler,
        heated_pipe,
        held_steady,
        tclab,
        wet_tower,
    )
    from hil.record.raw import ReadingOptions, RecordError
    from hil.record.reader import Record, read_record, require_record_suffix, write_record
    from hil.record.segments import Parts
    from hil.record.units import name_and_unit

__all__ = [
    "PIPE_TESTS",
    "VALUES",
    "WATER_DENSITY",
    "DialectError",
    "Parts",
    "PublicRecord",
    "ReadingOptions",
    "Record",
    "RecordError",
    "beginning_of",
    "dry_cooler",
    "find_dialect",
    "foreign_kind",
    "heated_pipe",
    "held_steady",
    "is_annotated",
    "is_labview",
    "is_waveforms",
    "name_and_unit",
    "read_cells",
    "read_record",
    "require_record_suffix",
    "tag_samples",
    "tclab",
    "wet_tower",
    "write_record",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "csv_file.annotated": ("is_annotated",),
        "csv_file.labview": ("is_labview",),
        "csv_file.labview_exports": ("is_waveforms",),
        "csv_file.dialect": (
            "DialectError",
            "find_dialect",
        ),
        "csv_file.encodings": ("beginning_of",),
        "file": ("foreign_kind", "read_cells"),
        "units.headings": ("name_and_unit",),
        "layouts.long_format": ("VALUES",),
        "layouts.tags": ("tag_samples",),
        "public": (
            "PublicRecord",
            "PIPE_TESTS",
            "WATER_DENSITY",
            "dry_cooler",
            "heated_pipe",
            "held_steady",
            "tclab",
            "wet_tower",
        ),
        "raw": (
            "ReadingOptions",
            "RecordError",
        ),
        "reader": (
            "Record",
            "read_record",
            "require_record_suffix",
            "write_record",
        ),
        "segments": ("Parts",),
    },
)
