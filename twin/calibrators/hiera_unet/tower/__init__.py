"""The network calibrator's subject "cooling-tower cell": channels, memory, windows, training, gate and scores.

The names below are the package's interface; they are loaded on first use, because most of them need the extra ``ml``.
Modules among them are for the training of a network. Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("cell_table", "ensemble", "member", "predict", "score", "table"),
        "cell_table": ("CellTable",),
        "commissioned": ("commissioned_log_power", "commissioned_outlet"),
        "ensemble": (
            "BRANCHES",
            "CAUSAL",
            "EnsembleAnswer",
            "SYMMETRIC",
            "TowerEnsemble",
            "load_tower_ensemble = load_ensemble",
        ),
        "member": ("MemberTraining", "adapt", "load_fleet", "load_member"),
        "plan": ("TowerPlan",),
        "predict": ("Blindness", "Predicted", "predict_windows = predict"),
        "windows": ("Fleet",),
    },
)
