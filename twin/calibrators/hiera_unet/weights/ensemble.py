"""Ensemble statistics: mean of means; mean of the members' variances plus the variance of their means."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.calibrators.hiera_unet.training.score import ScoredWindows
from twin.network import Array


def mixed(means: Sequence[Array], variances: Sequence[Array]) -> tuple[Array, Array]:
    """Return mean and variance of a mixture in equal parts: aleatoric plus epistemic. A single member has no second
    part.
    """
    m, v = np.stack(means), np.stack(variances)
    return m.mean(axis=0), v.mean(axis=0) + m.var(axis=0)


def together(members: Sequence[ScoredWindows]) -> ScoredWindows:
    """Return the ensemble's prediction for windows that each member has predicted.

    `scale` is that of the Laplace distribution with the mixture's variance.
    """
    first = members[0]
    error, variance = mixed([o.error for o in members], [2.0 * o.scale**2 for o in members])
    theta, spread = mixed([o.theta for o in members], [o.theta_sd**2 for o in members])
    return ScoredWindows(
        error=error,
        scale=np.sqrt(variance / 2.0),
        before=first.before,
        rival=first.rival,
        theta=theta,
        theta_sd=np.sqrt(spread),
        theta_error=theta - first.theta + first.theta_error,
        evidence_error=first.evidence_error,
        changed=first.changed,
        delta=np.mean([o.delta for o in members], axis=0),
    )
