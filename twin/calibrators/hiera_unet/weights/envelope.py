"""Training envelope: distance of a window from all windows that a network was trained on.

It depends on the window itself, by mean and spread of its channels over the context. Features of the network would not
serve: they may be one point for all training windows, and another if a target is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.hiera_unet.data.windows import TARGET
from twin.network import Array

SHRINK = 0.1
"""Share of the mean variance that the covariance is shrunk towards, since there are more features than independent
windows."""
INSIDE = 0.995


def place(x: np.ndarray, m: np.ndarray) -> Array:
    """Return means and standard deviations (N, 2 C) of channels x (N, n, C) before the target, with mask m; NaN if
    absent.
    """
    there = m[:, :-TARGET].astype(np.float64)
    values = np.where(there > 0.0, x[:, :-TARGET], 0.0).astype(np.float64)
    count = there.sum(axis=1)
    with np.errstate(invalid="ignore"):
        mean = np.where(count > 0.0, values.sum(axis=1) / np.maximum(count, 1.0), np.nan)
        square = (values**2).sum(axis=1) / np.maximum(count, 1.0)
        return np.concatenate([mean, np.sqrt(np.maximum(square - mean**2, 0.0))], axis=1)


@dataclass(frozen=True)
class Envelope:
    """Gaussian envelope: mean (F,), precision (F, F), and the distance that covers 99.5 % of held-out windows."""

    mean: Array
    precision: Array
    limit: float

    def distance(self, features: Array) -> Array:
        """Return Mahalanobis distances (N,) of features (N, F), as a share of the limit: above 1 is outside.

        Missing features (NaN) take their mean.
        """
        d = np.nan_to_num(features - self.mean)
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", d, self.precision, d), 0.0)) / self.limit)


def envelope(features: Array, unseen: Array) -> Envelope:
    """Return the envelope of training features (N, F), with its limit from features (M, F) of held-out windows."""
    mean = np.nan_to_num(np.nanmean(features, axis=0))
    covariance = np.cov(np.nan_to_num(features - mean), rowvar=False)
    level = np.trace(covariance) / len(covariance)
    shrunk = (1.0 - SHRINK) * covariance + SHRINK * level * np.eye(len(covariance))
    open_ended = Envelope(mean, np.linalg.inv(shrunk), 1.0)
    return Envelope(mean, open_ended.precision, float(np.quantile(open_ended.distance(unseen), INSIDE)))
