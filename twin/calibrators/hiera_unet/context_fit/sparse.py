"""Sparse posterior of deviations, by a spike-and-slab prior over all sets of a few changed parameters.

A fit changes all parameters a little for a change of one. Here each parameter has changed or not: a deviation is N(0,
spike^2), or with some probability N(0, slab^2), and of P parameters only a few are slabs. Every such set is a Gaussian
prior. With a Gaussian likelihood

    L(theta) = exp(-theta' A theta / 2 + h' theta)

its posterior and its weight have closed forms:

    covariance C = (A + S^-1)^-1, mean C h,  log weight = log prior + (log|C| - log|S| + h' C h) / 2

and the answer is their mixture: for P = 9 and three at most, 130 of them, half a millisecond. Source: Mitchell &
Beauchamp, JASA 83 (1988) 1023; George & McCulloch, JASA 88 (1993) 881.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from twin.network import Array

MOST = 3
"""Parameters that may change at once."""


@dataclass(frozen=True)
class Likelihood:
    """Gaussian likelihood of deviations: information A (P, P), symmetric, and pull h (P,); see above."""

    information: Array
    pull: Array

    @classmethod
    def nothing(cls, count: int) -> Likelihood:
        """Return the likelihood without data."""
        return cls(np.zeros((count, count)), np.zeros(count))

    def plain(self) -> Array:
        """Return the pull, and the upper triangle of the information by rows: (P + P (P + 1) / 2,)."""
        return np.concatenate([self.pull, self.information[np.triu_indices(len(self.pull))]])

    @classmethod
    def of_plain(cls, numbers: Array, count: int) -> Likelihood:
        """Restore from the result of `plain` for `count` parameters."""
        upper = np.zeros((count, count))
        upper[np.triu_indices(count)] = numbers[count:]
        return cls(upper + np.triu(upper, 1).T, np.asarray(numbers[:count], dtype=np.float64))


@dataclass(frozen=True)
class Usual:
    """Spike-and-slab prior of P deviations.

    chance (P,): probability that one has changed; slab, spike (P,): standard deviations of one that has and of one that
    has not.
    """

    chance: Array
    slab: Array
    spike: Array


@dataclass(frozen=True)
class Posterior:
    """Posterior mixture: mean, sd (P,) of the deviations, chance (P,) that each has changed."""

    mean: Array
    sd: Array
    chance: Array


def posterior(data: Likelihood, usual: Usual, most: int = MOST) -> Posterior:
    """Return the posterior over all sets of at most `most` changed parameters."""
    count = len(data.pull)
    moved = _sets(count, min(most, count))
    variance = np.where(moved, usual.slab**2, usual.spike**2)
    root = np.sqrt(variance)
    # In units of each prior, so that a spike of next to nothing is no trouble.
    whole = np.eye(count) + root[:, :, None] * data.information * root[:, None, :]
    inverse = np.linalg.inv(whole)
    scaled = root * data.pull
    mean = np.einsum("sij,sj->si", inverse, scaled)
    odds = np.log(usual.chance) - np.log1p(-usual.chance)
    weight = moved @ odds - 0.5 * np.linalg.slogdet(whole)[1] + 0.5 * np.einsum("si,si->s", scaled, mean)
    share = np.exp(weight - weight.max())
    share /= share.sum()
    mean *= root
    spread = np.einsum("sii->si", inverse) * variance
    middle = share @ mean
    square = share @ (spread + (mean - middle) ** 2)
    return Posterior(middle, np.sqrt(square), share @ moved)


@lru_cache(maxsize=8)
def _sets(count: int, most: int) -> np.ndarray:
    """Return the sets (sets, P) bool of at most `most` of `count`."""
    chosen = [c for size in range(most + 1) for c in combinations(range(count), size)]
    moved = np.zeros((len(chosen), count), dtype=bool)
    for row, columns in enumerate(chosen):
        moved[row, list(columns)] = True
    return moved
