"""How far a window is from everything that a network was trained on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.network import Array

SHRINK = 0.1
"""Share of the mean variance that the covariance is shrunk towards: features outnumber what windows can tell."""
INSIDE = 0.995


@dataclass(frozen=True)
class Envelope:
    """A Gaussian hull: mean (F,), precision (F, F), and the distance that 99.5 % of unseen windows stay within."""

    mean: Array
    precision: Array
    limit: float

    def distance(self, features: Array) -> Array:
        """Mahalanobis distances (N,) of features (N, F), as a share of the limit: above 1 is outside."""
        d = features - self.mean
        return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", d, self.precision, d), 0.0)) / self.limit)


def envelope(features: Array, unseen: Array) -> Envelope:
    """Of training features (N, F), with the limit set on features (M, F) of windows that were not trained on."""
    mean = features.mean(axis=0)
    covariance = np.cov(features - mean, rowvar=False)
    level = np.trace(covariance) / len(covariance)
    shrunk = (1.0 - SHRINK) * covariance + SHRINK * level * np.eye(len(covariance))
    open_ended = Envelope(mean, np.linalg.inv(shrunk), 1.0)
    return Envelope(mean, open_ended.precision, float(np.quantile(open_ended.distance(unseen), INSIDE)))
