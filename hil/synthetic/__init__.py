"""Synthetic records with hidden effects, drawn from a seed.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.synthetic.hidden_effects import Truth, effects_text, lasting, truth
    from hil.synthetic.plant_record import direct_record, direct_run
    from hil.synthetic.settings import LOADS, Setting, profile, profile_text, setting

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
            "Truth",
            "effects_text",
            "lasting",
            "truth",
        ),
        "settings": (
            "LOADS",
            "Setting",
            "profile",
            "profile_text",
            "setting",
        ),
        "plant_record": (
            "direct_record",
            "direct_run",
        ),
    },
)
