"""Training of the network calibrator on simulated rigs and the virtual rig's plant, never on recorded ones.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.training.ablation import PIECES, without
    from hil.training.data import TrainingData, least_windows, read
    from hil.training.generate import asked_of, complete, features_of
    from hil.training.generate import begun as generation_begun
    from hil.training.generate import generate as generate_windows
    from hil.training.plant_windows import PROFILES, equivalent_deviations, recorded, specimen_of
    from hil.training.session import TrainingProgress, TrainingRequest, train
    from hil.training.session import begun as training_begun
    from hil.training.stopping import Stop

__all__ = [
    "PIECES",
    "PROFILES",
    "Stop",
    "TrainingData",
    "TrainingProgress",
    "TrainingRequest",
    "asked_of",
    "complete",
    "equivalent_deviations",
    "features_of",
    "generate_windows",
    "generation_begun",
    "least_windows",
    "read",
    "recorded",
    "specimen_of",
    "train",
    "training_begun",
    "without",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "ablation": (
            "PIECES",
            "without",
        ),
        "data": (
            "TrainingData",
            "least_windows",
            "read",
        ),
        "generate": (
            "asked_of",
            "complete",
            "features_of",
            "generate_windows = generate",
            "generation_begun = begun",
        ),
        "plant_windows": (
            "PROFILES",
            "equivalent_deviations",
            "recorded",
            "specimen_of",
        ),
        "session": (
            "TrainingProgress",
            "TrainingRequest",
            "train",
            "training_begun = begun",
        ),
        "stopping": ("Stop",),
    },
)
