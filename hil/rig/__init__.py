"""Checks of a rig file, before a run and online.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.rig.check import as_json, checked_rig, show
    from hil.rig.element_kinds import kinds_table
    from hil.rig.notices import unguarded
    from hil.rig.online import watch_online

__all__ = ["as_json", "checked_rig", "kinds_table", "show", "unguarded", "watch_online"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "check": (
            "as_json",
            "checked_rig",
            "show",
        ),
        "element_kinds": ("kinds_table",),
        "notices": ("unguarded",),
        "online": ("watch_online",),
    },
)
