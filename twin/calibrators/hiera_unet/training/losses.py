"""Losses of eq. 9 to 11, dimensionless, each a mean over the known entries.

L = L_data + 0.30 L_bal + 0.08 L_smooth + 0.15 L_unc, with the published weights. Not in eq. 11: the known
parameters, and a penalty on corrections, higher for their mean over the window, which parameters should explain.
"""

from __future__ import annotations

import torch
from torch import Tensor

BETA = 0.5
"""Power of the predicted scale that weights a likelihood (Seitzer et al., ICLR 2022): without it badly predicted steps
lose their gradient, and the mean stalls."""
LOG_RANGE = 6.0
"""Largest absolute log-scale, so that an exponential never overflows."""
FAR = 3.0
"""Standard deviations beyond which a parameter's error counts linearly."""
RESOLUTION = 0.02
"""Least scale of an output, in units of the tolerance."""


def known_only(error: Tensor, known: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return errors with 0 where unknown, and a mask of the known ones: a NaN that is masked later would spoil
    gradients.
    """
    good = torch.isfinite(error) if known is None else known & torch.isfinite(error)
    return torch.where(good, error, 0.0), good


def mean_of(values: Tensor, good: Tensor) -> Tensor:
    """Return the mean over entries where `good`; 0 if there are none."""
    total = torch.where(good, values, 0.0).sum()
    return total / good.sum().clamp(min=1)


def data_loss(error: Tensor, tolerances: Tensor) -> Tensor:
    """Return the loss of eq. 9: mean |error| (B, n, Y) in units of the tolerances (Y,); NaN is left out."""
    e, good = known_only(error)
    return mean_of(e.abs() / tolerances, good)


def balance_loss(
    delta: Tensor, storage: Tensor, exchange: Tensor, rated: float, judged: Tensor, step_s: float
) -> Tensor:
    """Return the loss of eq. 10 for a twin with an exact balance: spurious power of the corrections, relative to 2.5 %
    rated.

    A twin's own readings balance exactly, so corrected ones deviate by what the corrections store and exchange. The
    storage is taken between the first and the last tenth of the window, where it exceeds the noise.

    Args:
        delta: (B, n, Y) K. storage: (Y,) J/K of each output's volume. exchange: (B, Y), W leaving the rig per K of each
            output. rated: W. judged: (B,) bool, False if the balance is known not to hold.
    """
    edge = max(delta.shape[1] // 10, 1)
    seconds = (delta.shape[1] - edge) * step_s
    stored = ((delta[:, -edge:].mean(1) - delta[:, :edge].mean(1)) * storage).sum(-1) / seconds
    lost = (delta.mean(1) * exchange).sum(-1)
    return mean_of((stored + lost).abs() / (0.025 * rated), judged)


def smooth_loss(theta: Tensor, bounds: Tensor, pairs: Tensor) -> Tensor:
    """Return the mean |theta_k - theta_(k-1)| / bound over pairs (Q, 2) of windows of one rig in one condition."""
    if not len(pairs):
        return theta.sum() * 0.0
    change = (theta[pairs[:, 0]] - theta[pairs[:, 1]]).abs() / bounds
    return change.mean()


def parameter_loss(theta: Tensor, true: Tensor, known: Tensor, bounds: Tensor) -> Tensor:
    """Return the mean square of (theta - true) / bound over known and identifiable entries (B, P).

    Squares are used because most parameters of most windows have not changed: zero would minimise absolute errors.
    """
    e, good = known_only(theta - true, known)
    return mean_of((e / bounds) ** 2, good)


def laplace_loss(error: Tensor, log_scale: Tensor, tolerances: Tensor) -> Tensor:
    """Return the negative log-likelihood, weighted by beta, of errors (B, n, Y) with Laplace scale tolerance *
    exp(log_scale).
    """
    s = log_scale.clamp(-LOG_RANGE, LOG_RANGE)
    b = torch.exp(s) + RESOLUTION
    e, good = known_only(error)
    return mean_of((torch.log(b) + e.abs() / tolerances / b) * b.detach() ** BETA, good)


def gaussian_loss(error: Tensor, log_variance: Tensor, bounds: Tensor, known: Tensor) -> Tensor:
    """Return the negative log-likelihood of known parameter errors (B, P), in units of the bounds, weighted by beta.

    The predicted variance is the whole variance, so that intervals match the loss. Errors beyond `FAR` standard
    deviations count linearly. A deviation with a predicted sd of four thousandths of its bound that has changed by a
    third would otherwise have a thousand times the usual gradient.
    """
    v = torch.exp(log_variance.clamp(-2 * LOG_RANGE, LOG_RANGE))
    e, good = known_only(error, known)
    away = (e / bounds).abs() / v.sqrt()
    square = torch.where(away < FAR, away**2, FAR * (2.0 * away - FAR))
    return mean_of(0.5 * (torch.log(v) + square) * v.detach() ** BETA, good)


def correction_price(delta: Tensor, tolerances: Tensor) -> tuple[Tensor, Tensor]:
    """Return the mean square of corrections (B, n, Y) in tolerances, and that of their means over the window."""
    d = delta / tolerances
    return (d**2).mean(), (d.mean(1) ** 2).mean()
