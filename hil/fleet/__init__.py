"""Many rigs, records and seeds: jobs of a fleet file, on workers, with one result each.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.fleet.fleet_file import Fleet, FleetError, read_fleet
    from hil.fleet.folder import FleetFolder, FleetFolderError
    from hil.fleet.jobs import Job, jobs_of
    from hil.fleet.session import FleetOutcome, FleetRequest, known_results, run_fleet
    from hil.fleet.table import rows_of, show_table

__all__ = [
    "Fleet",
    "FleetError",
    "FleetFolder",
    "FleetFolderError",
    "FleetOutcome",
    "FleetRequest",
    "Job",
    "jobs_of",
    "known_results",
    "read_fleet",
    "rows_of",
    "run_fleet",
    "show_table",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "fleet_file": ("Fleet", "FleetError", "read_fleet"),
        "folder": ("FleetFolder", "FleetFolderError"),
        "jobs": ("Job", "jobs_of"),
        "session": ("FleetOutcome", "FleetRequest", "known_results", "run_fleet"),
        "table": ("rows_of", "show_table"),
    },
)
