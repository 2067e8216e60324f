"""Log marginal likelihoods of effects in the quadratic form of a record.

With sizes x ~ N(0, S^2), Gram matrix G and score s of the whitened signatures, tunables and initial state integrated
out, the log Bayes factor over no effect is

    log B = 1/2 s' (G + S^-2)^-1 s - 1/2 log det(I + S G S)

An effect's form error is a further Gaussian of standard deviation `FORM_ERRORS` times the size. It has these columns:
the signature modulated over time by linear interpolation between knots, the signature modulated by each input, and its
part at each sensor, since a lumped twin distributes heat among its sensors otherwise than its rig. It is integrated out
with the sizes.

Source: linear-Gaussian evidence (MacKay, Neural Computation 4 (1992) 415, eqs. 2.5 and 4.3).
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, logsumexp

from twin.discovery.effects.open_laws.forms import LEAST_SPREAD
from twin.discovery.evidence.priors import FORM_ERRORS, FORM_S, SPREAD
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.network import Array

FEWEST_KNOTS = 3
"""Knots of a form error in a short record: beginning, middle and end."""
BEYOND = 9.0
"""Standard deviations beyond which the tail of a normal distribution is below rounding."""
LEAD, NEGLIGIBLE = 64, -math.log(np.finfo(np.float64).eps)
"""Effects whose log B is computed first, those that lead before their bounds are applied, and the loss of log B at
which an effect is below rounding."""
ORDERS = 3
"""Iterations for the order of sizes: a prior of the usual width shrinks large ones."""
KEPT_BYTES, MOST_TOGETHER = 1 << 26, 8
"""Bytes for the cached columns of effects, and effects whose columns are cached in any case."""


def log_mass(low: Array, high: Array) -> Array:
    """Return the logarithm of the standard normal probability between two bounds, also far out in the tails."""
    low, high = np.broadcast_arrays(low, high)
    found = np.zeros(low.shape)
    counts = (low > -BEYOND) | (high < BEYOND)
    if counts.any():
        found[counts] = _mass_of(low[counts], high[counts])
    return found


def _mass_of(low: Array, high: Array) -> Array:
    """Return `log_mass` of bounds (n,) of which at least one is within `BEYOND`."""
    found = np.empty(low.shape)
    near, far = low > -BEYOND, high < BEYOND
    # Of bounds far apart only the one nearer to the middle counts.
    alone = (high > BEYOND) & ((low <= 0.0) | (high > np.hypot(low, BEYOND)))
    above, below = near & alone, far & (low < -BEYOND) & (high >= 0.0)
    both = ~above & ~below
    found[above], found[below] = log_ndtr(-low[above]), log_ndtr(high[below])
    if both.any():
        found[both] = _mass_between(low[both], high[both])
    return found


def _mass_between(low: Array, high: Array) -> Array:
    flip = low > 0.0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    upper = log_ndtr(b)
    with np.errstate(divide="ignore"):
        found: Array = upper + np.log1p(-np.exp(np.minimum(log_ndtr(a) - upper, 0.0)))
    return found


def widths(typical: Array | float, sizes: Array | float) -> Array:
    """Return the standard deviations of the priors of effects with these sizes.

    The usual one is `SPREAD` typical sizes. For a larger size it is that size, at the prior cost of `log_widths`.
    """
    return np.maximum(SPREAD * np.asarray(typical), np.abs(sizes))


def log_widths(candidates: Sequence[Candidate], sizes: Array) -> float:
    """Return the log prior cost of sizes beyond the usual width, the sum of the logarithms of their ratios to it."""
    usual = SPREAD * np.array([c.typical for c in candidates])
    return float(np.log(np.maximum(np.abs(sizes) / usual, 1.0)).sum())


def log_bayes_of_sizes(candidates: Candidate | Sequence[Candidate], top: Array, bottom: Array) -> tuple[Array, Array]:
    """Return log B of single effects with scores `top` and squares `bottom`, and their sizes.

    The prior of a size is a Gaussian of the usual width or, if that is likelier, of its own order (`widths`), within
    its candidate's bounds.

    Args:
        candidates: one for all scores, which have any shape, or one for each row (c,) of scores (c, n).
    """
    if isinstance(candidates, Candidate):
        c = candidates
        typical, lower, upper = np.array(c.typical), np.array(c.lower), np.array(c.upper)
    else:
        typical, lower, upper = np.array([(c.typical, c.lower, c.upper) for c in candidates]).T[..., None]
    usual = SPREAD * typical
    odds, sizes = _within_bounds(usual, lower, upper, top, bottom)
    alone = np.abs(np.clip(top / bottom, lower, upper))
    large = np.asarray(alone > usual)
    if large.any():
        usual, lower, upper = (np.broadcast_to(v, odds.shape)[large] for v in (usual, lower, upper))
        wide = np.asarray(alone)[large]
        other, size = _within_bounds(
            wide, lower, upper, *(np.broadcast_to(v, odds.shape)[large] for v in (top, bottom))
        )
        other -= np.log(wide / usual)
        better = other > odds[large]
        odds[large], sizes[large] = np.where(better, other, odds[large]), np.where(better, size, sizes[large])
    return odds, sizes


def _within_bounds(prior: Array, lower: Array, upper: Array, top: Array, bottom: Array) -> tuple[Array, Array]:
    """Return log B and sizes under Gaussian priors of these standard deviations, truncated to bounds."""
    variance = 1.0 / (bottom + 1.0 / prior**2)
    mean, sd = variance * top, np.sqrt(variance)
    odds = 0.5 * mean * top - 0.5 * np.log1p(prior**2 * bottom)
    here = log_mass((lower - mean) / sd, (upper - mean) / sd)
    return np.array(odds + here - log_mass(lower / prior, upper / prior)), np.array(np.clip(mean, lower, upper))


def free_log_bayes(candidate: Candidate, top: Array, bottom: Array) -> Array:
    """Return log B of sizes whose priors are not truncated to their bounds."""
    usual = SPREAD * candidate.typical
    half = 0.5 * top**2
    odds: Array = half / (bottom + usual**-2.0) - 0.5 * np.log1p(usual**2 * bottom)
    alone = np.abs(top / bottom)
    large = np.flatnonzero(alone.ravel() > usual)
    if len(large):  # any other has the usual width
        halves, bottoms = (np.broadcast_to(values, odds.shape).ravel()[large] for values in (half, bottom))
        wide = alone.ravel()[large]
        other = halves / (bottoms + 1.0 / wide**2)
        other -= np.log(np.sqrt(1.0 + wide**2 * bottoms) * (wide / usual))
        flat = odds.reshape(-1)
        flat[large] = np.maximum(flat[large], other)
    return odds


def most_log_bayes(candidate: Candidate, top: Array, bottom: Array) -> Array:
    """Return an upper bound of `free_log_bayes` that takes no logarithm of each effect.

    With a prior of standard deviation w, the first term 1/2 top^2 / (bottom + w^-2) of log B is at most 1/2 top^2 /
    bottom. Its other terms, -1/2 log(1 + w^2 bottom) - log(w / usual), fall with w >= usual and with `bottom`. So they
    are at most -1/2 log(1 + usual^2 b), with b the least `bottom`.
    """
    usual = SPREAD * candidate.typical
    most: Array = 0.5 * top**2 / bottom - 0.5 * math.log1p(usual**2 * float(bottom.min()))
    return most


def likeliest(candidate: Candidate, top: Array, bottom: Array) -> NDArray[np.intp]:
    """Return the indices of those effects with scores `top` (n,) and squares `bottom` (n,) that are not negligible.

    The bounds of a size raise log B by at most the prior's own truncation, which bounds it from above. All effects that
    are left out add less than rounding to the likeliest one.
    """
    most = most_log_bayes(candidate, top, bottom)
    prior = SPREAD * candidate.typical
    before = _log_mass(candidate.lower / prior, candidate.upper / prior)
    lead = np.argpartition(most, -min(LEAD, len(most)))[-LEAD:]
    least = float(log_bayes_of_sizes(candidate, top[lead], bottom[lead])[0].max())
    least += before - NEGLIGIBLE - math.log(len(most))
    some = np.flatnonzero(most >= least)
    found: NDArray[np.intp] = some[free_log_bayes(candidate, top[some], bottom[some]) >= least]
    return found


def _log_mass(low: float, high: float) -> float:
    """Return `log_mass` of one pair of bounds."""
    if low > 0.0:
        low, high = -high, -low
    upper = float(log_ndtr(high))
    share = -math.expm1(min(float(log_ndtr(low)) - upper, 0.0))
    return upper + math.log(share) if share > 0.0 else -math.inf


def form_basis(score_test: ScoreTest) -> Array:
    """Return the weights (b, j) of linear interpolation between knots `FORM_S` apart, and of the inputs."""
    known: Array | None = score_test.memo.get("form basis")
    if known is None:
        hours = score_test.hours + 0.5 * score_test.step_s / 3600.0
        count = max(round(score_test.grid.span_s / FORM_S) + 1, FEWEST_KNOTS)
        knots = np.linspace(0.0, score_test.grid.span_s / 3600.0, count)
        lines = [np.interp(hours, knots, row) for row in np.eye(count)]
        known = np.stack([*lines, *_followed(score_test)], axis=1)
        score_test.memo["form basis"] = known
    return known


def _followed(score_test: ScoreTest) -> list[Array]:
    """Return the inputs (b,) that a size may depend on, standardised."""
    found = []
    for values in score_test.block_means(score_test.grid.inputs).T:
        spread = float(np.std(values))
        if spread > LEAST_SPREAD * max(float(np.abs(values).max()), 1e-9):
            found.append((values - values.mean()) / spread)
    return found


@dataclass(frozen=True, eq=False)
class Joint:
    """Effects whose sizes and form errors are integrated out.

    Attributes:
        score_test: of the record. seen: (b * m, c) whitened signatures of all their columns.
        scale: (c,) prior standard deviations of the columns.
        root: (c, c), root @ root' the inverse of I + S G S. form_error: its likeliest share.
        log_bayes: over no effect, averaged over the shares. quadratic: twice the part of it that depends on the data.
        log_width: prior cost of sizes beyond the usual width, which `log_bayes` contains.
        sizes: (e,) of the effects.
    """

    score_test: ScoreTest
    seen: Array
    scale: Array
    root: Array
    form_error: float
    log_bayes: float
    quadratic: float
    log_width: float
    sizes: Array

    @cached_property
    def onto(self) -> Array:
        """Return the products (sites * b, c) of the columns with a unit at each site and block."""
        return self.score_test.onto((self.seen * self.scale) @ self.root)

    def reduced_score(self, score_test: ScoreTest) -> Array:
        """Return the score (sites * b,) of a score test with these effects integrated out."""
        pull = self.scale * score_test.scores_of(self.seen)
        found: Array = score_test.score - self.onto @ (self.root.T @ pull)
        return found

    def reduced(self, seen: Array, gram: Array, score: Array) -> tuple[Array, Array]:
        """Return the Gram matrix (c, c) and score (c,) of signatures `seen` (b * m, c) with these effects integrated
        out.

        Args:
            gram, score: of `seen`, tunables and initial state projected out.
        """
        mine = (self.seen * self.scale) @ self.root
        both = self.score_test.across(np.concatenate([mine, seen], axis=1))
        shared, pull = both[: mine.shape[1], mine.shape[1] :], self.score_test.scores_of(mine)
        return gram - shared.T @ shared, score - shared.T @ pull


def _in_order(parts: list[Array]) -> Array:
    """Return columns (r, 1 + c) of effects in the order of `joint`: first each effect, then each one's form errors."""
    return np.concatenate([*(p[:, :1] for p in parts), *(p[:, 1:] for p in parts)], axis=1)


def _columns(score_test: ScoreTest, entry: Entry) -> Array:
    """Return the whitened signatures (b * m, 1 + c) of an effect at size 1 and of its form errors.

    They are the same in all sets of effects, and cached.
    """
    known: OrderedDict[int, tuple[Array, Array]] = score_test.memo.setdefault("columns", OrderedDict())
    key = id(entry.vector)  # with the vector, whose identity so stays its own
    if key in known:
        known.move_to_end(key)
        return known[key][1]
    made = _seen(score_test, entry.vector)
    known[key] = entry.vector, made
    while len(known) > max(KEPT_BYTES // made.nbytes, 2 * MOST_TOGETHER):
        known.popitem(last=False)
    return made


def joint(score_test: ScoreTest, entries: Sequence[Entry]) -> Joint:
    """Return the evidence of effects together; their shapes stay fixed."""
    count, candidates = len(entries), [e.candidate for e in entries]
    typical = np.array([c.typical for c in candidates])
    seen = _in_order([_columns(score_test, e) for e in entries])
    each = seen.shape[1] // count - 1
    gram, score = score_test.across(seen), score_test.scores_of(seen)
    prior, sizes = SPREAD * typical, np.zeros(count)
    for _ in range(ORDERS):
        sizes = np.asarray(
            np.linalg.solve(gram[:count, :count] + np.diag(prior**-2.0), score[:count]), dtype=np.float64
        )
        prior = widths(typical, sizes)
    less = log_widths(candidates, sizes)
    found: list[tuple[float, float, Array, Array, Array]] = []
    for share in FORM_ERRORS:
        scale = np.concatenate([prior, np.repeat(share * np.abs(sizes), each)])
        values, axes = np.linalg.eigh(np.eye(len(scale)) + gram * np.outer(scale, scale))
        root = axes / np.sqrt(np.maximum(values, 1.0))
        pull = root.T @ (scale * score)
        quadratic = float(pull @ pull)
        mean = scale * (root @ pull)
        spread = scale * np.sqrt((root**2).sum(axis=1))
        log_bayes = 0.5 * quadratic - 0.5 * float(np.log(np.maximum(values, 1.0)).sum()) - less
        log_bayes += sum(
            _within(e.candidate, float(m), float(s), float(p))
            for e, m, s, p in zip(entries, mean, spread, prior, strict=False)
        )
        found.append((log_bayes, quadratic, scale, root, mean[:count]))
    best = max(range(len(found)), key=lambda i: found[i][0])
    log_bayes, quadratic, scale, root, mean = found[best]
    total = float(logsumexp([f[0] for f in found]) - np.log(len(found)))
    return Joint(score_test, seen, scale, root, FORM_ERRORS[best], total, quadratic, less, mean)


def _within(candidate: Candidate, mean: float, sd: float, prior: float) -> float:
    """Return the log ratio of the posterior to the prior probability that a size is within its candidate's bounds."""
    low, high = candidate.lower, candidate.upper
    return _log_mass((low - mean) / sd, (high - mean) / sd) - _log_mass(low / prior, high / prior)


def form_quadratic(score_test: ScoreTest, entries: Sequence[Entry], share: float) -> float:
    """Return twice the data's part of the log likelihood that form errors of fitted effects gain at the current run."""
    seen = np.concatenate([_seen(score_test, e.vector)[:, 1:] for e in entries], axis=1)
    scale = np.repeat(share * np.abs([e.size for e in entries]), seen.shape[1] // len(entries))
    gram, score = score_test.across(seen), score_test.scores_of(seen)
    inner = np.eye(len(scale)) + gram * np.outer(scale, scale)
    pull = scale * score
    return float(pull @ np.linalg.solve(inner, pull))


def _seen(score_test: ScoreTest, vector: Array) -> Array:
    """Return the whitened signatures (b * m, 1 + c) of an effect, `vector` (sites, b), and of its form errors."""
    basis = np.column_stack([np.ones(score_test.b), form_basis(score_test)])
    over_time = score_test.seen_at(vector, basis)
    response = score_test.noise.colour(over_time[:, 0].reshape(score_test.b, score_test.m), score_test.step_s)
    return np.concatenate([over_time, score_test.features(response[:, :, None] * np.eye(score_test.m))], axis=1)
