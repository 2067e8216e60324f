"""Hiera-UNet calibrator: a network that reads two hours of a record and corrects the twin's parameters and outputs.

The names below are the package's interface; they are loaded on first use, because most of them need the extra ``ml``.
Modules among them are for the training of a network. Its packages, from below: `model`, `data`, `context_fit`,
`simulated` and `training`, `weights`, `serve` and `tower`. `data`, `context_fit` and `simulated` need no torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.context_fit import ContextFit, ParameterPrior, evidence
    from twin.calibrators.hiera_unet.data import (
        Deviations,
        Features,
        Frame,
        ResampledSeries,
        Windows,
        channels,
        parameters,
        series,
    )
    from twin.calibrators.hiera_unet.model import HieraError
    from twin.calibrators.hiera_unet.serve import (
        Ensemble,
        HieraUNetCalibrator,
        RefinedCalibrator,
        gates,
        load_ensemble,
        members,
    )
    from twin.calibrators.hiera_unet.simulated import Family, LabelledRecord, Store, campaigns, gaps, store
    from twin.calibrators.hiera_unet.training import Trainer, TrainingPlan, batches, score
    from twin.calibrators.hiera_unet.weights import (
        Identity,
        Member,
        binding,
        checkpoint,
        conformal,
        device,
        ensemble,
        envelope,
        leakage,
    )


__all__ = [
    "ContextFit",
    "Deviations",
    "Ensemble",
    "Family",
    "Features",
    "Frame",
    "HieraError",
    "HieraUNetCalibrator",
    "Identity",
    "LabelledRecord",
    "Member",
    "ParameterPrior",
    "RefinedCalibrator",
    "ResampledSeries",
    "Store",
    "Trainer",
    "TrainingPlan",
    "Windows",
    "batches",
    "binding",
    "campaigns",
    "channels",
    "checkpoint",
    "conformal",
    "device",
    "ensemble",
    "envelope",
    "evidence",
    "gaps",
    "gates",
    "leakage",
    "load_ensemble",
    "members",
    "parameters",
    "score",
    "series",
    "store",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "context_fit": ("ContextFit", "ParameterPrior", "evidence"),
        "data": ("Deviations", "Features", "Frame", "ResampledSeries", "Windows", "channels", "parameters", "series"),
        "model": ("HieraError",),
        "serve": ("Ensemble", "HieraUNetCalibrator", "RefinedCalibrator", "gates", "load_ensemble", "members"),
        "simulated": ("Family", "LabelledRecord", "Store", "campaigns", "gaps", "store"),
        "training": ("Trainer", "TrainingPlan", "batches", "score"),
        "weights": (
            "Identity",
            "Member",
            "binding",
            "checkpoint",
            "conformal",
            "device",
            "ensemble",
            "envelope",
            "leakage",
        ),
    },
)
