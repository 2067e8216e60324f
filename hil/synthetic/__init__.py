"""Synthetic records with hidden effects, drawn from a seed.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.synthetic.hidden_effects import (
        LOADS,
        Setting,
        Truth,
        effects_text,
        lasting,
        profile,
        profile_text,
        setting,
        truth,
    )
    from hil.synthetic.plant_record import direct_record, direct_run

__all__ = [
    "LOADS",
    "Setting",
    "Truth",
    "direct_record",
    "direct_run",
    "effects_text",
    "lasting",
    "profile",
    "profile_text",
    "setting",
    "truth",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "hidden_effects": (
            "LOADS",
            "Setting",
            "Truth",
            "effects_text",
            "lasting",
            "profile",
            "profile_text",
            "setting",
            "truth",
        ),
        "plant_record": (
            "direct_record",
            "direct_run",
        ),
    },
)
