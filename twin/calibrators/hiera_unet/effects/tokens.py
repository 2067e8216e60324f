"""Tokens of the network: one a hypothesis and window, from the window scores alone.

No token holds a name, a place or a unit, so the network takes any number of hypotheses in any order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.calibrators.hiera_unet.effects.balance import KINDS, Hypothesis
from twin.calibrators.hiera_unet.effects.memory import LAGS
from twin.calibrators.hiera_unet.effects.scores import Scores
from twin.network import Array

LOCAL = 4 * len(LAGS) + len(KINDS)
"""Features of a hypothesis."""
COMMON = 2 * len(LAGS) + 6
"""Features of the window that all hypotheses share."""
WIDTH = LOCAL + COMMON


def tokens(scores: Scores, hypotheses: Sequence[Hypothesis]) -> Array:
    """Return the tokens (K, H, WIDTH), single precision.

    Of each hypothesis: score, squared score over the largest one, and its share of the misfit for each onset; its kind.
    Of the window: misfit a degree of freedom, largest score for each onset; memory, transition, past, age.
    """
    z, k, h = scores.z, *scores.z.shape[:2]
    square = z**2
    largest = square.max(axis=1, keepdims=True)
    misfit = np.maximum(scores.misfit, 1e-9)[:, None, :]
    own = np.log1p(square / scores.past[:, None, None]) * np.sign(z)
    kind = np.array([[float(one.kind == name) for name in KINDS] for one in hypotheses])
    nodes = sum(one.kind == "heat_source" for one in hypotheses)
    common = np.concatenate(
        [
            np.log1p(scores.misfit / (scores.count * nodes)),
            np.log1p(largest[:, 0] / scores.past[:, None]),
            np.log1p(scores.novelty)[:, None],
            np.log1p(scores.unrest)[:, None],
            np.log1p(scores.unrest_before)[:, None],
            np.log(scores.past)[:, None],
            np.log(scores.count[:, -1:]) / 4.0,
            np.full((k, 1), nodes / 8.0),
        ],
        axis=1,
    )
    found = np.concatenate(
        [
            own,
            np.log1p(square),
            square / np.maximum(largest, 1e-9),
            np.minimum(square / misfit, 2.0),
            np.broadcast_to(kind, (k, h, len(KINDS))),
            np.broadcast_to(common[:, None], (k, h, COMMON)),
        ],
        axis=2,
    )
    return found.astype(np.float32)
