"""Hiera-UNet calibrator: a network that reads two hours of a record and corrects the twin's parameters and outputs.

The names below are the package's interface; they are loaded on first use, because most of them need the extra ``ml``.
Modules among them are for the training of a network. Its packages, from below: `model`, `data`, `context_fit`,
`simulated` and `training`, `weights`, `serve` and `tower`. `data`, `context_fit` and `simulated` need no torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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

_PACKAGES = {
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
}
_HOME = {name: f"{__name__}.{package}" for package, names in _PACKAGES.items() for name in names}

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


def __getattr__(name: str) -> Any:
    """Load a public name from its package on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
