"""Batches of windows as tensors on the training device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin.calibrators.hiera_unet.data.windows import Windows

Simulate = Callable[[Tensor, Windows], Tensor]
"""Differentiable function from deviations (B, P) and their windows to the twin's outputs (B, 120, Y)."""


@dataclass(frozen=True)
class Batch:
    """Batch of B windows as tensors with the names of `Windows`.

    `goal` is the truth where it is known, else the measurement; `rows` the windows themselves, for the twin.
    """

    x: Tensor
    m: Tensor
    regime: Tensor
    clock: Tensor
    meta: Tensor
    base: Tensor
    goal: Tensor
    theta: Tensor
    known: Tensor
    changed: Tensor
    rows: Windows

    @classmethod
    def of(cls, rows: Windows, device: torch.device | str = "cpu") -> Batch:
        goal = np.where(np.isfinite(rows.truth), rows.truth, rows.target)

        def put(a: np.ndarray, kind: torch.dtype) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(a)).to(device, kind)

        return cls(
            x=put(rows.x, torch.float32),
            m=put(rows.m, torch.bool),
            regime=put(rows.regime, torch.int64),
            clock=put(rows.clock, torch.float32),
            meta=put(rows.meta, torch.float32),
            base=put(rows.base, torch.float32),
            goal=put(goal, torch.float32),
            theta=put(rows.theta, torch.float32),
            known=put(rows.known, torch.bool),
            changed=put(rows.changed, torch.bool),
            rows=rows,
        )
