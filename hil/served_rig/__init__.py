"""Rig that is served as its rig file describes it, with a twin as its plant.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.served_rig.served_file import moved_rig
    from hil.served_rig.start import INVERSE_CRIME, ServedRig, ServedRigError, ServedRigOptions, serve, start_served_rig

__all__ = ["INVERSE_CRIME", "ServedRig", "ServedRigError", "ServedRigOptions", "moved_rig", "serve", "start_served_rig"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "served_file": ("moved_rig",),
        "start": ("INVERSE_CRIME", "ServedRig", "ServedRigError", "ServedRigOptions", "serve", "start_served_rig"),
    },
)
