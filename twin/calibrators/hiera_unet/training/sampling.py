"""Sampling of windows for a training step."""

from __future__ import annotations

import json

import numpy as np
import torch
from torch import Tensor

from twin.calibrators.hiera_unet.data.windows import Windows
from twin.calibrators.hiera_unet.model.config import Config
from twin.calibrators.hiera_unet.training.plan import TrainingPlan


class Sampler:
    """Sampler of random rows, with some adjacent windows of one rig in one condition among them.

    Attributes:
        healthy: rows without undeclared changes and with negligible deviations.
        moved: rows in which a parameter deviates by a known amount.
        neighbours: (Q, 2) consecutive rows of one rig with constant parameters.
    """

    def __init__(self, windows: Windows, config: Config, plan: TrainingPlan) -> None:
        self.plan, self.count = plan, len(windows)
        deviation = np.abs(np.where(np.isfinite(windows.theta), windows.theta, 0.0)) / np.array(config.bounds)
        self.healthy = np.flatnonzero(~windows.changed & (deviation.max(1) <= plan.healthy))
        self.moved = np.flatnonzero((windows.known & (deviation > plan.healthy)).any(1))
        self.neighbours = neighbours(windows)
        self._rng = np.random.default_rng(plan.seed)

    def draw(self, structural: bool) -> tuple[np.ndarray, Tensor]:
        """Return rows (B,) and the pairs (Q, 2) among them, as positions in the batch."""
        if structural:
            return self._rng.choice(self.healthy, self.plan.batch), torch.zeros(0, 2, dtype=torch.long)
        pairs = min(self.plan.pairs, len(self.neighbours))
        chosen = self.neighbours[self._rng.integers(0, len(self.neighbours), pairs)] if pairs else np.zeros((0, 2), int)
        rest = self.plan.batch - 2 * pairs
        moved = self._rng.choice(self.moved, round(self.plan.moved * rest)) if self.moved.size else np.zeros(0, int)
        single = self._rng.integers(0, self.count, rest - moved.size)
        return np.concatenate([chosen.ravel(), moved, single]).astype(np.intp), torch.arange(2 * pairs).reshape(
            pairs, 2
        )

    def state(self) -> str:
        return json.dumps(self._rng.bit_generator.state)

    def restore(self, state: str) -> None:
        self._rng.bit_generator.state = json.loads(state)


def neighbours(windows: Windows) -> np.ndarray:
    """Return pairs (Q, 2) of rows i, i + 1 of the same commissioned twin with the same deviations."""
    if len(windows) < 2:
        return np.zeros((0, 2), dtype=np.intp)
    rig = (windows.nominal[1:] == windows.nominal[:-1]).all(1)
    with np.errstate(invalid="ignore"):
        stays = np.abs(windows.theta[1:] - windows.theta[:-1]) <= 1e-3
    stays |= np.isnan(windows.theta[1:]) & np.isnan(windows.theta[:-1])
    first = np.flatnonzero(rig & stays.all(1) & (windows.changed[1:] == windows.changed[:-1]))
    return np.column_stack([first, first + 1])
