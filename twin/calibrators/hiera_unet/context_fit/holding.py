"""What the twin takes on of a proposal: the record fitted from what the network believes, what may not move held.

The network's parameters are drawn towards what is usual: of a rig that has changed they read halfway. And what data
tell is mostly sums of parameters: with one of two taken on and the other left as it was, a twin would be neither what
the network proposes nor what it was before. So the latest stretch that one set of parameters explains (`evidence`) is
fitted once more with the network's belief as the prior: what the record tells moves to where the twin reads right, all
else stays where the network has it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.hiera_unet.context_fit.evidence import ParameterPrior, estimate
from twin.calibrators.hiera_unet.data.features import Features, Frame
from twin.network import Array

NARROWEST, HELD = 0.03, 0.01
"""Least standard deviation of the network's belief, and that of what is held, as shares of what was known before any
data."""


@dataclass(frozen=True)
class Taken:
    """Deviations (P,) to take on, and linearisations that it cost."""

    theta: Array
    evaluations: int = 0


def taken(
    features: Features, frame: Frame, values: Array, said: Array, sd: Array, held: np.ndarray, now: Array
) -> Taken:
    """Deviations that explain the context of a window from the belief `said` (P,) with `sd` (P,).

    Args:
        values: full vector (p,) of the commissioned twin. held: (P,) bool, those that stay at `now` (P,).
    """
    if held.all():
        return Taken(now)
    wide = features.deviations.prior_sd
    spread = np.where(held, HELD * wide, np.clip(sd, NARROWEST * wide, wide))
    found = estimate(features, frame, values, belief=ParameterPrior(np.where(held, now, said), spread))
    return Taken(np.where(held, now, found.theta), found.evaluations)
