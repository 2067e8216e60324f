"""Recording of the virtual station: instruments, defects, archive.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.virtual.tower.recording.archive import archived, scan_times
    from drivers.virtual.tower.recording.defects import Seeding, TagSamples, seed_archive, seed_scans
    from drivers.virtual.tower.recording.instrumentation import Instrument, StationTruth, instruments, scanned, tag_name


__all__ = [
    "Instrument",
    "Seeding",
    "StationTruth",
    "TagSamples",
    "archived",
    "instruments",
    "scan_times",
    "scanned",
    "seed_archive",
    "seed_scans",
    "tag_name",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "archive": ("archived", "scan_times"),
        "defects": ("Seeding", "TagSamples", "seed_archive", "seed_scans"),
        "instrumentation": ("Instrument", "StationTruth", "instruments", "scanned", "tag_name"),
    },
)
