"""Diagnosis of a calibrated tower cell: undeclared effects by log marginal likelihood with declared priors.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.tower.diagnosis.adoption import adopted, effects_of
    from twin.tower.diagnosis.search import CellCase, CellHypothesis, ClaimedEffect, TowerDiagnosis, search_effects
    from twin.tower.diagnosis.validation import HeldOutBlocks


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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "adoption": ("adopted", "effects_of"),
        "search": ("CellCase", "CellHypothesis", "ClaimedEffect", "TowerDiagnosis", "search_effects"),
        "validation": ("HeldOutBlocks",),
    },
)
