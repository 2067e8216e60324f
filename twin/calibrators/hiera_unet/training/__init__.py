"""Training of one network: plan, batches, hiding, losses, the twin inside the graph, and scores.

The names below are the package's interface; they are loaded on first use, because some need the extra ``ml``.
Modules among them are public as a whole. Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.training.plan import TrainingPlan
    from twin.calibrators.hiera_unet.training.train import Trainer


__all__ = [
    "Trainer",
    "TrainingPlan",
    "batches",
    "score",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("batches", "score"),
        "plan": ("TrainingPlan",),
        "train": ("Trainer",),
    },
)
