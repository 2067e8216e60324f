"""Joint update of the posteriors of several cells by observations that they share.

Source: batch Kalman (Bayesian linear) update; the cells are independent before it, and each keeps its own covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.tower.air import Array
from twin.tower.estimates import Estimate


def joint_update(
    posteriors: Sequence[Estimate], crosses: Sequence[Array], covariance: Array, innovation: Array
) -> list[Estimate]:
    """Return the posteriors after r shared observations.

    Parameters
    ----------
    crosses
        Of each cell, its covariance with the observations (unknowns, r).
    covariance
        Of the innovation (r, r), noise included.
    innovation
        Observed less expected (r,).
    """
    right = np.column_stack([innovation, *(cross.T for cross in crosses)])
    gain = np.asarray(np.linalg.solve(covariance, right), dtype=np.float64)
    found, start = [], 1
    for posterior, cross in zip(posteriors, crosses, strict=True):
        width = cross.shape[0]
        found.append(_updated(posterior, cross, gain[:, 0], gain[:, start : start + width]))
        start += width
    return found


def _updated(p: Estimate, cross: Array, innovation: Array, gain: Array) -> Estimate:
    """Return a posterior after the update; the residuals follow linearly."""
    change = cross @ innovation
    covariance = p.covariance - cross @ gain
    slow = p.slow + change[: p.slow.size].reshape(p.slow.shape)
    constant = p.constant + change[p.slow.size :]
    moved = np.concatenate(
        [(slow - p.slow)[p.cell], np.broadcast_to(constant - p.constant, (len(p.cell), len(constant)))], axis=1
    )
    of_outlet = np.einsum("ij,ij->i", p.jacobian, moved)
    return replace(
        p,
        slow=slow,
        constant=constant,
        covariance=0.5 * (covariance + covariance.T),
        residual=p.residual - of_outlet,
        linear_residual=p.linear_residual - of_outlet,
    )
