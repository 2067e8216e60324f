"""Segments of a record, and ranges of its inputs, in which the squares of a whitened residual concentrate.

Segments are the pieces of constant variance into which the likelihood partitions the record. For an input, blocks are
sorted by its value, and every interval is compared with the rest: two variances, neither below that of noise, against
one. The root of this likelihood ratio is lowered by a penalty of the interval's length, since short intervals are
numerous. Both thresholds are exceeded by pure noise with probability `LEVEL`, by simulation.

Sources: optimal partitioning of Jackson et al., IEEE Signal Process. Lett. 12 (2005) 105; multiscale scan with the
length penalty of Dümbgen & Spokoiny, Ann. Statist. 29 (2001) 124.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtrc

from twin.network import Array

LEVEL = 0.01
"""False-alarm probability of one kind of lead in a record of noise."""
COINCIDENCE = 0.05
"""False-alarm probability of a dependence on an input, for misfit that depends on none: the usual 5 %, as a lead is a
hint, and a record of some hours has no more than a hundred shifts to compare with."""
DRAWS = 499
"""Simulated records of noise per threshold, so that a hundredth of one more than these is a whole number."""
MOST_SEGMENTS, MOST_RANGES = 3, 2
"""Segments, and ranges of inputs, that are named: an operator looks at a few places."""
LEAST_SHARE = 0.1
"""Least share of the squares beyond noise that a segment holds."""
NOTED = 0.1
"""Share of a record's misfit that effects must leave beyond noise for leads: no form of an effect is exact."""
GROUPS = 24
"""Groups of equally many blocks, by the value of an input; each has ten blocks of 240."""


@dataclass(frozen=True)
class ResidualSquares:
    """Squares of a whitened residual: `total` (b,) over `count` (b,) values each, of variance one or less in health."""

    total: Array
    count: Array

    @property
    def present(self) -> bool:
        """Return True if the squares are more than noise makes with probability `LEVEL`."""
        whole = float(self.count.sum())
        return whole > 0.0 and float(chdtrc(whole, self.total.sum())) < LEVEL

    @property
    def beyond(self) -> float:
        """Return the sum of the squares beyond noise."""
        return float((self.total - self.count).sum())

    def share(self, rows: np.ndarray) -> float:
        """Return the share of all squares beyond noise that some rows (b,) hold, from 0 to 1."""
        there = float((self.total - self.count)[rows].sum())
        return float(np.clip(there / max(self.beyond, 1e-9), 0.0, 1.0))


@dataclass(frozen=True)
class Concentration:
    """An interval in which squares concentrate.

    Attributes
    ----------
    rows
        (b,) bool, blocks of the record.
    share
        Of the squares beyond noise.
    of_record
        Share of the blocks that are measured.
    """

    rows: np.ndarray
    share: float
    of_record: float


def segments(squares: ResidualSquares) -> tuple[Concentration, ...]:
    """Return the segments of a record in which squares concentrate, in order of time; none where only noise is left.

    The record is cut into pieces of one variance each by the least -2 log likelihood, where each cut costs as much as
    noise gains by one with probability `LEVEL`. Pieces above the record's mean are joined where they meet, and those
    that hold most are taken.
    """
    total, count = squares.total, squares.count.astype(np.float64)
    cuts = _cuts(total, count, _cut_cost(tuple(count.tolist())))
    if len(cuts) < 3:
        return ()
    index, dense = np.arange(len(total)), np.zeros(len(total), dtype=bool)
    for a, b in itertools.pairwise(cuts):
        piece = _concentration(squares, (index >= a) & (index < b))
        dense[a:b] = piece.share > piece.of_record
    borders = np.flatnonzero(np.diff(np.concatenate([[False], dense, [False]]).astype(int)))
    runs = [(index >= a) & (index < b) for a, b in zip(borders[::2], borders[1::2], strict=True)]
    found = sorted((_concentration(squares, rows) for rows in runs), key=lambda c: -c.share)[:MOST_SEGMENTS]
    return tuple(sorted((c for c in found if c.share >= LEAST_SHARE), key=lambda c: int(np.argmax(c.rows))))


def _cuts(total: Array, count: Array, cost: float) -> list[int]:
    """Return the borders, 0 and b among them, of the likeliest pieces of one variance each, by dynamic programming."""
    b = len(total)
    sums, many = np.append(0.0, np.cumsum(total)), np.append(0.0, np.cumsum(count))
    best, before = np.full(b + 1, np.inf), np.zeros(b + 1, dtype=int)
    best[0] = -cost
    for end in range(1, b + 1):
        tried = best[:end] + cost + _unlikely(sums[end] - sums[:end], many[end] - many[:end])
        before[end] = int(tried.argmin())
        best[end] = tried[before[end]]
    borders = [b]
    while borders[-1]:
        borders.append(int(before[borders[-1]]))
    return borders[::-1]


def input_ranges(squares: ResidualSquares, inputs: Array, memory: int | None) -> tuple[tuple[int, Concentration], ...]:
    """Return the columns on whose value the squares depend, with the blocks in the range that holds them; best first.

    A misfit of some hours meets some value of every input. A column is therefore named only if its range also stands
    out among those of the residual shifted against the inputs (circular shifts, all columns together, each in standard
    deviations of its own scores).

    Parameters
    ----------
    inputs
        (b, c), means over the same blocks.
    memory
        Blocks after which the residual has forgotten an input; None if rows are independent of each other, which then
        are permuted.
    """
    columns = [j for j in range(inputs.shape[1]) if np.ptp(inputs[:, j]) > 0.0]
    groups = [_groups(inputs[:, j]) for j in columns]
    used = [(j, g) for j, g in zip(columns, groups, strict=True) if g.max() > 0]
    if not used:
        return ()
    b, count = len(squares.total), squares.count.astype(np.float64)
    rng = np.random.default_rng(0)
    orders = _orders(b, memory, rng)
    noise = _noise(count, rng, DRAWS)
    if 1.0 / (1 + len(orders)) > COINCIDENCE:
        return ()
    drawn, highest = np.full(DRAWS, -np.inf), np.full(len(orders), -np.inf)
    candidates: list[tuple[float, float, int, np.ndarray]] = []
    for j, group in used:
        onto = (group[:, None] == np.arange(group.max() + 1)).astype(np.float64)
        found, first, last = _scan((squares.total @ onto)[None], (count @ onto)[None])
        drawn = np.maximum(drawn, _scan(noise @ onto, (count @ onto)[None])[0])
        moved = np.maximum(_scan(squares.total[orders] @ onto, count[orders] @ onto)[0], 0.0)
        # An input of many values scores high by chance, so each column is measured by its own chance scores.
        usual, spread = float(moved.mean()), max(float(moved.std()), 1e-9)
        highest = np.maximum(highest, (moved - usual) / spread)
        score = float(found[0])
        candidates.append(((score - usual) / spread, score, j, (group >= first[0]) & (group < last[0])))
    limit = _quantile(drawn)
    named = []
    for odd, score, j, rows in sorted(candidates, key=lambda c: -c[0]):
        chance = (1 + int((highest >= odd).sum())) / (1 + len(orders))
        if score > limit and chance <= COINCIDENCE:
            named.append((j, _concentration(squares, rows)))
    return tuple(named[:MOST_RANGES])


def _orders(b: int, memory: int | None, rng: np.random.Generator) -> np.ndarray:
    """Return orders of blocks (n, b) under which the residual is independent of the inputs."""
    if memory is None:
        return np.stack([rng.permutation(b) for _ in range(DRAWS)])
    shifts = np.arange(memory + 1, b - memory)
    return (np.arange(b)[None, :] + shifts[:, None]) % b


def _groups(values: Array) -> np.ndarray:
    """Return the group (b,) of each block by its value, from 0; equal values are of one group."""
    different = np.unique(values)
    if len(different) <= GROUPS:
        return np.searchsorted(different, values)
    cuts = np.unique(np.quantile(values, np.arange(1, GROUPS) / GROUPS))
    found = np.searchsorted(cuts, values, side="right")
    return np.unique(found, return_inverse=True)[1]


def _concentration(squares: ResidualSquares, rows: np.ndarray) -> Concentration:
    measured = squares.count > 0
    of_record = float((rows & measured).sum() / max(int(measured.sum()), 1))
    return Concentration(rows, squares.share(rows), of_record)


def _scan(total: Array, count: Array) -> tuple[Array, np.ndarray, np.ndarray]:
    """Return the best score (d,) of an interval of each of d series, with its first group and the one after its last.

    Parameters
    ----------
    total, count
        (d, g), and (d, g) or (1, g).
    """
    d, g = total.shape
    sums = np.concatenate([np.zeros((d, 1)), np.cumsum(total, axis=1)], axis=1)
    many = np.concatenate([np.zeros((len(count), 1)), np.cumsum(count, axis=1)], axis=1)
    whole, everything = sums[:, -1:], many[:, -1:]
    one = _unlikely(whole, everything)
    score, first, last = np.full(d, -np.inf), np.zeros(d, dtype=int), np.full(d, g)
    for a in range(g):
        inside, n = sums[:, a + 1 :] - sums[:, [a]], many[:, a + 1 :] - many[:, [a]]
        outside, rest = whole - inside, everything - n
        more = inside * np.maximum(rest, 1.0) > outside * np.maximum(n, 1.0)
        gain = np.maximum(one - _unlikely(inside, n) - _unlikely(outside, rest), 0.0)
        penalty = np.sqrt(2.0 * (1.0 + np.log(np.maximum(everything, 1.0) / np.maximum(n, 1.0))))
        found = np.where(more & (n > 0.0) & (rest > 0.0), np.sqrt(gain) - penalty, -np.inf)
        at = found.argmax(axis=1)
        value = found[np.arange(d), at]
        better = value > score
        score, first, last = (
            np.where(better, value, score),
            np.where(better, a, first),
            np.where(better, a + at + 1, last),
        )
    return score, first, last


def _unlikely(squares: Array, count: Array) -> Array:
    """Return -2 log likelihood of squares at their own variance, which is one at least."""
    n = np.maximum(count, 1.0)
    variance = np.maximum(squares / n, 1.0)
    found: Array = count * np.log(variance) + squares / variance
    return found


def _noise(count: Array, rng: np.random.Generator, draws: int) -> Array:
    """Return squares (draws, b) of records of noise."""
    found: Array = np.where(count > 0.0, rng.chisquare(np.maximum(count, 1.0), (draws, len(count))), 0.0)
    return found


def _quantile(scores: Array) -> float:
    """Return the score that noise exceeds with probability `LEVEL`."""
    return float(np.sort(scores)[round((len(scores) + 1) * (1.0 - LEVEL)) - 1])


@lru_cache(maxsize=16)
def _cut_cost(count: Sequence[float]) -> float:
    """Return the cost of a cut that noise exceeds with probability `LEVEL`, from the best interval over its cuts."""
    many = np.array(count)
    noise = _noise(many, np.random.default_rng(0), DRAWS)
    sums = np.concatenate([np.zeros((DRAWS, 1)), np.cumsum(noise, axis=1)], axis=1)
    n = np.append(0.0, np.cumsum(many))
    one = _unlikely(sums[:, -1], n[-1])
    most = np.zeros(DRAWS)
    for a in range(len(many)):
        inside, within = sums[:, a + 1 :] - sums[:, [a]], n[a + 1 :] - n[a]
        # Both sides of an interval may have variances of their own, as pieces have.
        early = _unlikely(sums[:, [a]], n[[a]])
        late = _unlikely(sums[:, [-1]] - sums[:, a + 1 :], n[-1] - n[a + 1 :])
        gain = one[:, None] - early - _unlikely(inside, within) - late
        cuts = float(a > 0) + (np.arange(a + 1, len(many) + 1) < len(many))
        most = np.maximum(most, (gain / np.maximum(cuts, 1.0)).max(axis=1))
    return _quantile(most)
