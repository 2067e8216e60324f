"""Recording of the virtual station: instruments, defects, archive.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.tower.recording.archive import archived, scan_times
    from drivers.virtual.tower.recording.defects import Seeding, TagSamples, seed_archive, seed_scans
    from drivers.virtual.tower.recording.instrumentation import Instrument, StationTruth, instruments, scanned, tag_name

_MODULES = {
    "archive": (
        "archived",
        "scan_times",
    ),
    "defects": (
        "TagSamples",
        "Seeding",
        "seed_archive",
        "seed_scans",
    ),
    "instrumentation": (
        "Instrument",
        "StationTruth",
        "instruments",
        "scanned",
        "tag_name",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

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


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
