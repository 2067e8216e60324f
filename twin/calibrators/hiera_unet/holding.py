"""What to take on of a proposal when some of its parameters may not move.

What data tell is mostly sums of parameters: with one of two taken on and the other left as it was, a twin would be
neither what the network proposes nor what it was before. So those that may move go where the twin reads, over all that
the window holds of the record, what it would read with all of the proposal.
"""

from __future__ import annotations

import numpy as np

from twin.calibrators.hiera_unet.evidence import STATE_SD, step_noise
from twin.calibrators.hiera_unet.features import Features, Frame
from twin.gauss_newton import Data, Prior, Problem
from twin.network import Array

MOST = 4
"""Linearisations: what is held is seldom far off in what the record tells."""


def given(features: Features, frame: Frame, values: Array, said: Array, held: np.ndarray, now: Array) -> Array:
    """Deviations (P,) that read as `said` (P,) does, with those that are `held` (P,) bool left `now` (P,).

    Args:
        values: full vector (p,) of the commissioned twin.
    """
    if not held.any() or held.all():
        return np.where(held, now, said)
    rows, deviations = slice(frame.begin, None), features.deviations
    time, inputs = np.ascontiguousarray(frame.time[rows]), np.ascontiguousarray(frame.held[rows])
    readings = features.kernel.trace(deviations.full(said, values), frame.start, time, inputs)[0][0]
    weight = np.broadcast_to(1.0 / step_noise(features), readings.shape).copy()
    nodes = len(features.network.nodes)
    begun = np.concatenate([np.where(held, now, said), frame.start[:nodes]])
    precision = np.diag(np.concatenate([deviations.prior_sd, np.full(nodes, STATE_SD)]) ** -2.0)
    problem = Problem(
        features.kernel, deviations.scaling(values), values, Data(time, inputs, readings, weight), frame.start
    )
    stay = np.concatenate([held, np.zeros(nodes, dtype=bool)])
    fit = problem.minimise(begun, Prior(begun.copy(), precision), held=stay, most=MOST, tolerance=1e-3)
    return fit.v[: len(deviations)] if np.isfinite(fit.cost) else begun[: len(deviations)]
