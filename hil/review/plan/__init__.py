"""Plan of a review: entities with their styles, tabs, panels and margins. Plain data.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.review.plan.run_plan import make_plan, worst_state
    from hil.review.plan.styles import (
        FAINT,
        GREEN,
        NEUTRAL,
        ORANGE,
        QUALITY_NAMES,
        RED,
        TRACKED,
        Colour,
        Lane,
        Lines,
        Panel,
        ReviewPlan,
        Stack,
        path,
        symbol,
        twin_colours,
    )

__all__ = [
    "FAINT",
    "GREEN",
    "NEUTRAL",
    "ORANGE",
    "QUALITY_NAMES",
    "RED",
    "TRACKED",
    "Colour",
    "Lane",
    "Lines",
    "Panel",
    "ReviewPlan",
    "Stack",
    "make_plan",
    "path",
    "symbol",
    "twin_colours",
    "worst_state",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "run_plan": (
            "make_plan",
            "worst_state",
        ),
        "styles": (
            "Colour",
            "FAINT",
            "GREEN",
            "Lane",
            "Lines",
            "NEUTRAL",
            "ORANGE",
            "Panel",
            "ReviewPlan",
            "QUALITY_NAMES",
            "RED",
            "Stack",
            "TRACKED",
            "path",
            "symbol",
            "twin_colours",
        ),
    },
)
