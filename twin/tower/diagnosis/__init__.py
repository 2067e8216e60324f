"""Diagnosis of a calibrated tower cell: undeclared effects by log marginal likelihood with declared priors.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.tower.diagnosis.adoption import adopted, effects_of
    from twin.tower.diagnosis.search import CellCase, CellHypothesis, ClaimedEffect, TowerDiagnosis, search_effects
    from twin.tower.diagnosis.validation import HeldOutBlocks

_MODULES = {
    "adoption": (
        "adopted",
        "effects_of",
    ),
    "search": (
        "search_effects",
        "CellCase",
        "ClaimedEffect",
        "CellHypothesis",
        "TowerDiagnosis",
    ),
    "validation": ("HeldOutBlocks",),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "CellCase",
    "CellHypothesis",
    "ClaimedEffect",
    "HeldOutBlocks",
    "TowerDiagnosis",
    "adopted",
    "effects_of",
    "search_effects",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
