"""Detection of changes that no event announces: steps of a thermometer, jumps of deviations.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.tower.change_detection.changes import RATE_D, undeclared_changes
    from twin.tower.change_detection.contradictions import (
        Contradiction,
        contradictory_steps,
        jumping_column,
        merged,
        most_steps,
        spans_beyond,
    )
    from twin.tower.change_detection.rates import changing_rate
    from twin.tower.change_detection.steps import Step, find_steps, with_fan


__all__ = [
    "RATE_D",
    "Contradiction",
    "Step",
    "changing_rate",
    "contradictory_steps",
    "find_steps",
    "jumping_column",
    "merged",
    "most_steps",
    "spans_beyond",
    "undeclared_changes",
    "with_fan",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "changes": ("RATE_D", "undeclared_changes"),
        "contradictions": (
            "Contradiction",
            "contradictory_steps",
            "jumping_column",
            "merged",
            "most_steps",
            "spans_beyond",
        ),
        "rates": ("changing_rate",),
        "steps": ("Step", "find_steps", "with_fan"),
    },
)
