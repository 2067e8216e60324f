"""Hiera-UNet calibrator: a network that reads two hours of a record and corrects the twin's parameters and outputs.

The names below are the package's interface; they are loaded on first use, because most of them need the extra ``ml``.
Modules among them are for the training of a network. Everything else is private to the package.
Modules without torch: `windows`, `channels`, `features`, `regimes`, `evidence`, `campaigns`.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.campaigns import LabelledRecord
    from twin.calibrators.hiera_unet.checkpoint import Identity, Member
    from twin.calibrators.hiera_unet.config import HieraError
    from twin.calibrators.hiera_unet.evidence import ContextFit, ParameterPrior
    from twin.calibrators.hiera_unet.features import Features, Frame
    from twin.calibrators.hiera_unet.members import Ensemble, load_ensemble
    from twin.calibrators.hiera_unet.parameters import Deviations
    from twin.calibrators.hiera_unet.plan import TrainingPlan
    from twin.calibrators.hiera_unet.plants import Family
    from twin.calibrators.hiera_unet.refined import RefinedCalibrator
    from twin.calibrators.hiera_unet.series import ResampledSeries
    from twin.calibrators.hiera_unet.service import HieraUNetCalibrator
    from twin.calibrators.hiera_unet.store import Store
    from twin.calibrators.hiera_unet.train import Trainer
    from twin.calibrators.hiera_unet.windows import Windows

_MODULES = {
    "campaigns": ("LabelledRecord",),
    "checkpoint": ("Identity", "Member"),
    "config": ("HieraError",),
    "evidence": ("ParameterPrior", "ContextFit"),
    "features": ("Features", "Frame"),
    "members": ("Ensemble", "load_ensemble"),
    "parameters": ("Deviations",),
    "plan": ("TrainingPlan",),
    "plants": ("Family",),
    "refined": ("RefinedCalibrator",),
    "series": ("ResampledSeries",),
    "service": ("HieraUNetCalibrator",),
    "store": ("Store",),
    "train": ("Trainer",),
    "windows": ("Windows",),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

_PUBLIC_MODULES = (
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
    "members",
    "parameters",
    "score",
    "series",
    "store",
)
"""Parts that `hil.training` puts together: each is public as a whole."""

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
    """Load a public name from its module on first use."""
    if name in _PUBLIC_MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
