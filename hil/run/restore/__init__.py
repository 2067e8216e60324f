"""Restore of a run that was interrupted: its position, its temperatures, its calibrators.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.run.restore.calibrators import restore_calibrators
    from hil.run.restore.gap_evidence import KEY, clocks_recorded, duration_s, with_gap
    from hil.run.restore.resumption import Resumption, RunPosition
    from hil.run.restore.thermal_restore import RestoreRule, ThermalRestore, restore_obstacle, role_of, stores_heat

__all__ = [
    "KEY",
    "RestoreRule",
    "Resumption",
    "RunPosition",
    "ThermalRestore",
    "clocks_recorded",
    "duration_s",
    "restore_calibrators",
    "restore_obstacle",
    "role_of",
    "stores_heat",
    "with_gap",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "calibrators": ("restore_calibrators",),
        "gap_evidence": (
            "KEY",
            "clocks_recorded",
            "duration_s",
            "with_gap",
        ),
        "resumption": (
            "Resumption",
            "RunPosition",
        ),
        "thermal_restore": (
            "RestoreRule",
            "ThermalRestore",
            "restore_obstacle",
            "role_of",
            "stores_heat",
        ),
    },
)
