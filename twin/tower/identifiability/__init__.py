"""Identifiability of a cell's deviations, and the step test that improves it.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.tower.identifiability.identify import MOST_CONDITION, MOST_HIDDEN, Identifiability, condition_text
    from twin.tower.identifiability.planning import StepTest, model_sensitivities, plan_tests


__all__ = [
    "MOST_CONDITION",
    "MOST_HIDDEN",
    "Identifiability",
    "StepTest",
    "condition_text",
    "model_sensitivities",
    "plan_tests",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "identify": ("Identifiability", "MOST_CONDITION", "MOST_HIDDEN", "condition_text"),
        "planning": ("StepTest", "model_sensitivities", "plan_tests"),
    },
)
