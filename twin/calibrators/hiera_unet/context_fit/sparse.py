"""What is believed of deviations if few of them have moved: a spike and a slab each, and every set of a few of them.

A fit moves all parameters a little for what one did. Here each has moved or not: a deviation is N(0, spike^2), or with
some chance N(0, slab^2), and of P no more than a few are slabs. Every such set is a Gaussian prior of its own, so with
a Gaussian likelihood

    L(theta) = exp(-theta' A theta / 2 + h' theta)

its posterior and its weight are closed:

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
"""Parameters that may have moved at once."""


@dataclass(frozen=True)
class Likelihood:
    """What data says of deviations: information A (P, P), symmetric, and pull h (P,); see above."""

    information: Array
    pull: Array

    @classmethod
    def nothing(cls, count: int) -> Likelihood:
        """Of no data."""
        return cls(np.zeros((count, count)), np.zeros(count))

    def plain(self) -> Array:
        """(P + P (P + 1) / 2,): the pull, and the upper triangle of the information by rows."""
        return np.concatenate([self.pull, self.information[np.triu_indices(len(self.pull))]])

    @classmethod
    def of_plain(cls, numbers: Array, count: int) -> Likelihood:
        """From what `plain` gave for `count` parameters."""
        upper = np.zeros((count, count))
        upper[np.triu_indices(count)] = numbers[count:]
        return cls(upper + np.triu(upper, 1).T, np.asarray(numbers[:count], dtype=np.float64))


@dataclass(frozen=True)
class Usual:
    """What is usual of P deviations. chance (P,) that one has moved; slab, spike (P,) standard deviations of one that
    has and of one that has not."""

    chance: Array
    slab: Array
    spike: Array


@dataclass(frozen=True)
class Posterior:
    """mean, sd (P,) of the mixture, chance (P,) that each has moved."""

    mean: Array
    sd: Array
    chance: Array


def posterior(data: Likelihood, usual: Usual, most: int = MOST) -> Posterior:
    """Of all sets of at most `most` moved parameters."""
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
    """(sets, P) bool, the sets of at most `most` of `count`."""
    chosen = [c for size in range(most + 1) for c in combinations(range(count), size)]
    moved = np.zeros((len(chosen), count), dtype=bool)
    for row, columns in enumerate(chosen):
        moved[row, list(columns)] = True
    return moved
