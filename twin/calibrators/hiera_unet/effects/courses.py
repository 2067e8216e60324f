"""Course of a warning over a record: strength, place, kind, size and onset; and the linear rival."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.calibrators.hiera_unet.effects.balance import EVERY_S, Hypothesis
from twin.calibrators.hiera_unet.effects.memory import LAGS
from twin.calibrators.hiera_unet.effects.scores import Scores
from twin.network import Array

SD90 = 1.645


@dataclass(frozen=True)
class Course:
    """Course of a warning over K windows.

    Attributes
    ----------
    statistic
        Strength (K,): a warning is given where it exceeds the threshold.
    hypothesis
        Index of the likeliest hypothesis (K,).
    size, size_low, size_high
        Size (K,) with its 90 % interval, in the unit of the hypothesis.
    since_s, since_low_s, since_high_s
        Time since the onset (K,) with its 90 % interval, s.
    """

    statistic: Array
    hypothesis: np.ndarray
    size: Array
    size_low: Array
    size_high: Array
    since_s: Array
    since_low_s: Array
    since_high_s: Array


def linear_course(scores: Scores) -> Course:
    """Return the course of the largest window score, over the scatter of the record so far; nothing is learned."""
    k = len(scores.z)
    flat = np.abs(scores.z).reshape(k, -1)
    best = flat.argmax(axis=1)
    rows = np.arange(k)
    hypothesis, lag = np.divmod(best, len(LAGS))
    size = scores.size[rows, hypothesis, lag]
    reach = SD90 * np.sqrt(scores.past / scores.information[rows, hypothesis, lag])
    since = EVERY_S * scores.count[rows, lag]
    # The neighbouring onsets of the bank are as near as it can tell.
    near = np.array([(LAGS[max(j - 1, 0)] if j else 0, LAGS[min(j + 1, len(LAGS) - 1)]) for j in range(len(LAGS))])
    return Course(
        flat[rows, best] / np.sqrt(scores.past),
        hypothesis,
        size,
        size - reach,
        size + reach,
        since,
        EVERY_S * near[lag, 0],
        EVERY_S * near[lag, 1],
    )


def place_sums(probability: Array, hypotheses: Sequence[Hypothesis]) -> tuple[Array, tuple[str, ...]]:
    """Return the probability of each place (K, P), of hypotheses (K, H), and the places in order."""
    places = tuple(dict.fromkeys(h.where for h in hypotheses))
    member = np.array([[float(h.where == place) for place in places] for h in hypotheses])
    return probability @ member, places
