"""The network calibrator's subject "cooling-tower cell": channels, memory, windows, training, gate and scores.

The names below are the package's interface; they are loaded on first use, because most of them need the extra ``ml``.
Modules among them are for the training of a network. Everything else is private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.tower.cell_table import CellTable
    from twin.calibrators.hiera_unet.tower.commissioned import commissioned_log_power, commissioned_outlet
    from twin.calibrators.hiera_unet.tower.ensemble import (
        BRANCHES,
        CAUSAL,
        SYMMETRIC,
        EnsembleAnswer,
        TowerEnsemble,
    )
    from twin.calibrators.hiera_unet.tower.ensemble import load_ensemble as load_tower_ensemble
    from twin.calibrators.hiera_unet.tower.member import MemberTraining, adapt, load_fleet, load_member
    from twin.calibrators.hiera_unet.tower.plan import TowerPlan
    from twin.calibrators.hiera_unet.tower.predict import Blindness, Predicted
    from twin.calibrators.hiera_unet.tower.predict import predict as predict_windows
    from twin.calibrators.hiera_unet.tower.windows import Fleet

_MODULES = {
    "cell_table": {"CellTable": "CellTable"},
    "commissioned": {n: n for n in ("commissioned_log_power", "commissioned_outlet")},
    "ensemble": {
        **{n: n for n in ("BRANCHES", "CAUSAL", "SYMMETRIC", "EnsembleAnswer", "TowerEnsemble")},
        "load_tower_ensemble": "load_ensemble",
    },
    "member": {n: n for n in ("MemberTraining", "adapt", "load_fleet", "load_member")},
    "plan": {"TowerPlan": "TowerPlan"},
    "predict": {"Blindness": "Blindness", "Predicted": "Predicted", "predict_windows": "predict"},
    "windows": {"Fleet": "Fleet"},
}
_HOME = {public: (f"{__name__}.{module}", own) for module, names in _MODULES.items() for public, own in names.items()}

_PUBLIC_MODULES = (
    "cell_table",
    "ensemble",
    "member",
    "predict",
    "score",
    "table",
)
"""Parts that `hil.training` puts together: each is public as a whole."""

__all__ = [
    "BRANCHES",
    "CAUSAL",
    "SYMMETRIC",
    "Blindness",
    "CellTable",
    "EnsembleAnswer",
    "Fleet",
    "MemberTraining",
    "Predicted",
    "TowerEnsemble",
    "TowerPlan",
    "adapt",
    "cell_table",
    "commissioned_log_power",
    "commissioned_outlet",
    "ensemble",
    "load_fleet",
    "load_member",
    "load_tower_ensemble",
    "member",
    "predict",
    "predict_windows",
    "score",
    "table",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name in _PUBLIC_MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, own = _HOME[name]
    return getattr(import_module(module), own)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
