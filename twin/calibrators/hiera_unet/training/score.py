"""Scores of predictions with a hidden target: errors per output and parameter, coverage and width."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from twin.calibrators.hiera_unet.data.windows import Windows
from twin.calibrators.hiera_unet.model.heads import evidence_of
from twin.calibrators.hiera_unet.model.network import HieraUNet
from twin.calibrators.hiera_unet.training.batches import Batch, Simulate
from twin.calibrators.hiera_unet.training.hiding import blind
from twin.network import Array

NINETY = float(np.log(10.0))
"""Half width of a 90 % interval of a Laplace law, in its scale."""
MOVED = 0.05
"""Least deviation of a parameter that counts as changed."""


@dataclass(frozen=True)
class ScoredWindows:
    """Predictions of N windows with their references; NaN where the reference is unknown.

    Attributes:
        error, scale: (N, 120, Y), calibrated output minus reference, and Laplace scale, in the outputs' units.
        before, rival: (N, 120, Y), commissioned twin minus reference, and the twin with the evidence alone minus it.
        theta, theta_sd, theta_error, evidence_error: (N, P) in the parameters' units; errors only where known.
        changed: (N,).
        delta: (N, 120, Y) correction.
    """

    error: Array
    scale: Array
    before: Array
    rival: Array
    theta: Array
    theta_sd: Array
    theta_error: Array
    evidence_error: Array
    changed: Array
    delta: Array

    def metrics(self) -> dict[str, Any]:
        """Return mean absolute errors, those of changed parameters separately, and raw 90 % intervals."""
        inside = np.abs(self.error) <= NINETY * self.scale
        good = np.isfinite(self.error)
        moved = np.where(np.abs(self.theta - self.theta_error) > MOVED, 1.0, np.nan)
        return {
            "windows": len(self.error),
            "mae_before": _means(np.abs(self.before)),
            "mae_evidence": _means(np.abs(self.rival)),
            "mae": _means(np.abs(self.error)),
            "rmse_before": [None if v is None else v**0.5 for v in _means(self.before**2)],
            "rmse_evidence": [None if v is None else v**0.5 for v in _means(self.rival**2)],
            "rmse": [None if v is None else v**0.5 for v in _means(self.error**2)],
            "coverage90_raw": float(inside[good].mean()) if good.any() else None,
            "width90_raw": float(2.0 * NINETY * self.scale[good].mean()) if good.any() else None,
            "theta_mae": _means(np.abs(self.theta_error)[:, None]),
            "theta_mae_evidence": _means(np.abs(self.evidence_error)[:, None]),
            "theta_mae_moved": _means(np.abs(moved * self.theta_error)[:, None]),
            "theta_mae_moved_evidence": _means(np.abs(moved * self.evidence_error)[:, None]),
        }


def outcome(
    network: HieraUNet,
    windows: Windows,
    simulate: Simulate,
    told: np.ndarray,
    *,
    causal: bool = False,
    hidden: bool = True,
    batch: int = 24,
) -> ScoredWindows:
    """Return the scored predictions of windows.

    Args:
        told: (C,) bool, channels that reveal the answer. hidden: whether those of the target are hidden.
    """
    config = network.config
    device = next(network.parameters()).device
    answer = torch.from_numpy(told).to(device)
    bounds = np.array(config.bounds)
    tolerances = torch.tensor(config.tolerances, device=device)
    parts: dict[str, list[Any]] = {name: [] for name in ScoredWindows.__dataclass_fields__}
    with torch.inference_mode():
        for first in range(0, len(windows), batch):
            b = Batch.of(windows.take(slice(first, first + batch)), device)
            m = blind(b.m, answer, config.target) if hidden else b.m
            p = network(b.x, m, b.regime, b.clock, b.meta, causal=causal)
            true = np.where(b.rows.known, b.rows.theta, np.nan)
            given = evidence_of(config, b.meta)
            twin = simulate(p.theta if given is None else given.fit, b.rows)
            rival = torch.full_like(twin, torch.nan) if given is None else twin - b.goal
            y = twin + p.delta
            own = torch.full_like(p.theta, torch.nan) if given is None else given.fit
            rows = {
                "error": y - b.goal,
                "scale": torch.exp(p.log_scale.clamp(-6, 6)) * tolerances,
                "before": b.base - b.goal,
                "rival": rival,
                "theta": p.theta,
                "delta": p.delta,
            }
            for name, value in rows.items():
                parts[name].append(value.double().cpu().numpy())
            theta = parts["theta"][-1]
            log_variance = p.log_variance.clamp(-12, 6).float().cpu().numpy()
            parts["theta_sd"].append(np.exp(0.5 * log_variance) * bounds)
            parts["theta_error"].append(theta - true)
            parts["evidence_error"].append(own.double().cpu().numpy() - true)
            parts["changed"].append(b.rows.changed)
    return ScoredWindows(**{name: np.concatenate(values) for name, values in parts.items()})


def missed(simulate: Simulate, theta: Array, windows: Windows) -> Array:
    """Return the error (N, 120, Y) of the twin with deviations (N, P) against the reference; NaN where it is
    unknown.
    """
    with torch.inference_mode():
        twin = simulate(torch.from_numpy(np.ascontiguousarray(theta)), windows).numpy()
    error: Array = twin - np.where(np.isfinite(windows.truth), windows.truth, windows.target)
    return error


def average(values: Sequence[float | None]) -> float:
    """Return the mean of the known values; NaN without any."""
    known = [v for v in values if v is not None]
    return sum(known) / len(known) if known else float("nan")


def _means(values: Array) -> list[float | None]:
    """Return means over windows and steps, for each column; None for an unknown column."""
    good = np.isfinite(values)
    count = good.sum((0, 1))
    total = np.where(good, values, 0.0).sum((0, 1))
    return [float(t / n) if n else None for t, n in zip(total, count, strict=True)]
