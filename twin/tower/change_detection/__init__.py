"""Detection of changes that no event announces: steps of a thermometer, jumps of deviations.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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
    from twin.tower.change_detection.steps import Step, find_steps, with_fan

_MODULES = {
    "changes": (
        "RATE_D",
        "undeclared_changes",
    ),
    "contradictions": (
        "Contradiction",
        "contradictory_steps",
        "jumping_column",
        "merged",
        "most_steps",
        "spans_beyond",
    ),
    "steps": (
        "Step",
        "find_steps",
        "with_fan",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "RATE_D",
    "Contradiction",
    "Step",
    "contradictory_steps",
    "find_steps",
    "jumping_column",
    "merged",
    "most_steps",
    "spans_beyond",
    "undeclared_changes",
    "with_fan",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
