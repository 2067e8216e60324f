"""Adoption of a proposal by the live twin: a fit of the record with the network's prediction as prior and held
parameters fixed.

The network's parameters are shrunk towards those of its training rigs: after a change they are about halfway. Mostly
only sums of parameters are identifiable. With one of two adopted and the other fixed, a twin would be neither the
proposal nor the former twin. The latest segment that one set of parameters explains (`evidence`) is therefore fitted
once more with the network's prediction as the prior. Identifiable parameters move to the values at which the twin reads
correctly, all others stay at the prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.hiera_unet.context_fit.evidence import ParameterPrior, estimate
from twin.calibrators.hiera_unet.data.features import Features, Frame
from twin.network import Array

NARROWEST, HELD = 0.03, 0.01
"""Least standard deviation of the network's prediction, and that of held parameters, as shares of the prior's."""


@dataclass(frozen=True)
class Taken:
    """Deviations (P,) to adopt, and the number of linearisations."""

    theta: Array
    evaluations: int = 0


def taken(
    features: Features, frame: Frame, values: Array, said: Array, sd: Array, held: np.ndarray, now: Array
) -> Taken:
    """Return the deviations that explain the context of a window, with the prior mean `said` (P,) and `sd` (P,).

    Args:
        values: full vector (p,) of the commissioned twin. held: (P,) bool, those that stay at `now` (P,).
    """
    if held.all():
        return Taken(now)
    wide = features.deviations.prior_sd
    spread = np.where(held, HELD * wide, np.clip(sd, NARROWEST * wide, wide))
    found = estimate(features, frame, values, belief=ParameterPrior(np.where(held, now, said), spread))
    return Taken(np.where(held, now, found.theta), found.evaluations)
