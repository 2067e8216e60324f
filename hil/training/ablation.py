"""Ablations: trainings without a part of the network, to measure its contribution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hil.training.data import TrainingData
from twin.calibrators.hiera_unet import Windows, evidence

PIECES = {
    "hierarchy": "no stage merges: all four have the record at its own steps, without a coarse scale",
    "gates": "skips are concatenated directly",
    "evidence": "no Gauss-Newton estimate among the inputs",
    "residuals": "no channel compares measurement and twin",
    "hiding": "the target's own measurements are always among the inputs",
    "structure": "healthy windows do not come first",
    "balance": "no penalty on power of unknown origin",
}


def without(pieces: tuple[str, ...], config: Any, plan: Any, data: TrainingData) -> tuple[Any, Any, TrainingData]:
    """Return configuration, plan and data without the named `PIECES`."""
    if "hierarchy" in pieces:
        config = replace(config, merges=(1,) * len(config.merges))
    if "gates" in pieces:
        config = replace(config, gated=False)
    if "structure" in pieces:
        plan = replace(plan, structure=0.0)
    if "balance" in pieces:
        plan = replace(plan, weights=replace(plan.weights, balance=0.0))
    if "hiding" in pieces:
        plan = replace(plan, hiding=replace(plan.hiding, whole=0.0, blocks=False))
    if "evidence" in pieces:
        config = replace(config, evidence=False)
        data = _every(data, lambda w: replace(w, meta=_zeroed(w.meta, evidence.tokens(config.parameters))))
    if "residuals" in pieces:
        hidden = data.table.indices("r")
        data = _every(data, lambda w: replace(w, m=_unseen(w.m, hidden)))
    return config, plan, data


def _every(data: TrainingData, change: Callable[[Windows], Windows]) -> TrainingData:
    return replace(
        data,
        train=change(data.train),
        validation=change(data.validation),
        conformal=change(data.conformal),
        test=change(data.test),
    )


def _zeroed(meta: np.ndarray, last: int) -> np.ndarray:
    out = meta.copy()
    out[:, -last:] = 0.0
    return out


def _unseen(mask: np.ndarray, channels: np.ndarray) -> np.ndarray:
    out = mask.copy()
    out[..., channels] = False
    return out
