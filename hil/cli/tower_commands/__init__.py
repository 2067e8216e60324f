"""Command `hil tower` with its verbs, and the parts of `hil diagnose` and `hil train` that treat towers.

`hil tower` loads each verb by its module. The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.cli.tower_commands.diagnosis import diagnose_tower, is_tower
    from hil.cli.tower_commands.training import tower_command

__all__ = ["diagnose_tower", "is_tower", "tower_command"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "diagnosis": (
            "diagnose_tower",
            "is_tower",
        ),
        "training": ("tower_command",),
    },
)
