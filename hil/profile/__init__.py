"""Load profiles, and the scenarios of ship systems that make them.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.profile.load_profile import (
        WINDOW_S,
        WRITTEN_UNITS,
        Profile,
        ProfileError,
        SetpointLimit,
        read_profile,
        validate,
        write_profile,
    )
    from hil.profile.scenario import build, read_scenario
    from hil.profile.scenario_files import write_scenario

__all__ = [
    "WINDOW_S",
    "WRITTEN_UNITS",
    "Profile",
    "ProfileError",
    "SetpointLimit",
    "build",
    "read_profile",
    "read_scenario",
    "validate",
    "write_profile",
    "write_scenario",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "load_profile": (
            "Profile",
            "ProfileError",
            "SetpointLimit",
            "WINDOW_S",
            "WRITTEN_UNITS",
            "read_profile",
            "validate",
            "write_profile",
        ),
        "scenario": (
            "build",
            "read_scenario",
        ),
        "scenario_files": ("write_scenario",),
    },
)
