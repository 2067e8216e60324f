"""Explanation of a record: diagnoses and the experiments on the rig that settle an ambiguous one.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.explain.experiment import RigChoice
    from hil.explain.explanation import Experiment, Explanation, ExplanationError, Round, read_explanation
    from hil.explain.session import ExplainRequest, explain
    from hil.explain.terminal_report import print_explanation

__all__ = [
    "Experiment",
    "ExplainRequest",
    "Explanation",
    "ExplanationError",
    "RigChoice",
    "Round",
    "explain",
    "print_explanation",
    "read_explanation",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "experiment": ("RigChoice",),
        "explanation": (
            "Experiment",
            "Explanation",
            "ExplanationError",
            "Round",
            "read_explanation",
        ),
        "session": (
            "ExplainRequest",
            "explain",
        ),
        "terminal_report": ("print_explanation",),
    },
)
