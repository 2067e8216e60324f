"""Log marginal likelihoods of effects in the quadratic form of a record.

With sizes x ~ N(0, S^2), Gram matrix G and score s of the whitened signatures, tunables and initial state integrated
out, the logarithm of the likelihood's mean over that of no effect is

    log B = 1/2 s' (G + S^-2)^-1 s - 1/2 log det(I + S G S)

An effect's error of form is a further Gaussian of standard deviation `FORM_ERRORS` times the size: the same signature,
modulated over time by straight lines between knots, and what it does to each sensor alone, since a lumped twin sends
heat to its sensors in other shares than its rig. It is integrated out with the sizes.

Source: linear-Gaussian evidence (MacKay, Neural Computation 4 (1992) 415, eqs. 2.5 and 4.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, logsumexp

from twin.discovery.evidence.priors import FORM_ERRORS, FORM_S, SPREAD
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.search import Entry
from twin.elements.base import Candidate
from twin.network import Array

FEWEST_KNOTS = 3
"""Knots of an error of form in a short record: a beginning, a middle and an end."""


def log_mass(low: Array, high: Array) -> Array:
    """Return the logarithm of the standard normal probability between two bounds, which may be far out."""
    flip = low > 0.0
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    upper = log_ndtr(b)
    with np.errstate(divide="ignore"):
        found: Array = upper + np.log1p(-np.exp(np.minimum(log_ndtr(a) - upper, 0.0)))
    return found


def log_bayes_of_sizes(candidate: Candidate, top: Array, bottom: Array) -> tuple[Array, Array]:
    """Return log B of single effects with scores `top` and squares `bottom`, any shape, and their sizes.

    The prior of the size is a Gaussian within the candidate's bounds.
    """
    prior = SPREAD * candidate.typical
    variance = 1.0 / (bottom + prior**-2.0)
    mean, sd = variance * top, np.sqrt(variance)
    odds = 0.5 * mean * top - 0.5 * np.log1p(prior**2 * bottom)
    here = log_mass((candidate.lower - mean) / sd, (candidate.upper - mean) / sd)
    before = log_mass(np.array(candidate.lower / prior), np.array(candidate.upper / prior))
    return odds + here - before, np.clip(mean, candidate.lower, candidate.upper)


def form_basis(contest: Contest) -> Array:
    """Return the weights (b, j) of straight lines between knots `FORM_S` apart."""
    known: Array | None = contest.memo.get("form basis")
    if known is None:
        hours = contest.hours + 0.5 * contest.step_s / 3600.0
        count = max(round(contest.grid.span_s / FORM_S) + 1, FEWEST_KNOTS)
        knots = np.linspace(0.0, contest.grid.span_s / 3600.0, count)
        known = np.stack([np.interp(hours, knots, row) for row in np.eye(count)], axis=1)
        contest.memo["form basis"] = known
    return known


@dataclass(frozen=True)
class Joint:
    """Effects whose sizes and errors of form are integrated out.

    Attributes:
        columns: (c, sites * b), each times its prior standard deviation. onto: (sites * b, c) of the Gram matrix.
        root: (c, c), root @ root' the inverse of I + S G S. form_error: share, the likeliest.
        log_bayes: over no effect, averaged over the shares. quadratic: twice the logarithm's part that is of the data.
        sizes: (e,) of the effects.
    """

    columns: Array
    onto: Array
    root: Array
    form_error: float
    log_bayes: float
    quadratic: float
    sizes: Array

    def reduced_score(self, score: Array) -> Array:
        """Return a score (sites * b,) with these effects integrated out."""
        found: Array = score - self.onto @ (self.root @ (self.root.T @ (self.columns @ score)))
        return found


def joint(contest: Contest, entries: Sequence[Entry]) -> Joint:
    """Return the evidence of effects together; their shapes stay as they are."""
    count = len(entries)
    vectors = np.stack([e.vector for e in entries])
    prior = np.array([SPREAD * e.candidate.typical for e in entries])
    errors = _form_errors(contest, vectors)
    each = len(errors) // count
    every = np.concatenate([vectors.reshape(count, -1), errors])
    # Most effects act at one site: the others' columns are zeros.
    there = every.any(axis=0)
    few = every[:, there]
    onto = contest.gram[:, there] @ few.T
    gram, score = few @ onto[there], few @ contest.score[there]
    sizes = np.linalg.solve(gram[:count, :count] + np.diag(prior**-2.0), score[:count])
    found: list[tuple[float, float, Array, Array, Array]] = []
    for share in FORM_ERRORS:
        scale = np.concatenate([prior, np.repeat(share * np.abs(sizes), each)])
        values, axes = np.linalg.eigh(np.eye(len(scale)) + gram * np.outer(scale, scale))
        root = axes / np.sqrt(np.maximum(values, 1.0))
        pull = root.T @ (scale * score)
        quadratic = float(pull @ pull)
        mean = scale * (root @ pull)
        spread = scale * np.sqrt((root**2).sum(axis=1))
        log_bayes = 0.5 * quadratic - 0.5 * float(np.log(np.maximum(values, 1.0)).sum())
        log_bayes += sum(
            _within(e.candidate, float(m), float(s), float(p))
            for e, m, s, p in zip(entries, mean, spread, prior, strict=False)
        )
        found.append((log_bayes, quadratic, scale, root, mean[:count]))
    best = max(range(len(found)), key=lambda i: found[i][0])
    log_bayes, quadratic, scale, root, mean = found[best]
    total = float(logsumexp([f[0] for f in found]) - np.log(len(found)))
    return Joint(every * scale[:, None], onto * scale, root, FORM_ERRORS[best], total, quadratic, mean)


def _within(candidate: Candidate, mean: float, sd: float, prior: float) -> float:
    """Return how much likelier a size is to be within its candidate's bounds after the data than before, log."""
    low, high = candidate.lower, candidate.upper
    after = log_mass(np.array((low - mean) / sd), np.array((high - mean) / sd))
    return float(after - log_mass(np.array(low / prior), np.array(high / prior)))


def form_quadratic(contest: Contest, entries: Sequence[Entry], share: float) -> float:
    """Return twice the logarithm's part of the data that errors of form of fitted effects gain at the contest's run."""
    columns = _form_errors(contest, np.stack([e.vector for e in entries]))
    scale = np.repeat(share * np.abs([e.size for e in entries]), len(columns) // len(entries))
    there = columns.any(axis=0)
    few = columns[:, there]
    gram, score = few @ contest.gram[np.ix_(there, there)] @ few.T, few @ contest.score[there]
    inner = np.eye(len(scale)) + gram * np.outer(scale, scale)
    pull = scale * score
    return float(pull @ np.linalg.solve(inner, pull))


def _form_errors(contest: Contest, vectors: Array) -> Array:
    """Return what effects (e, sites, b) may do otherwise, all of one after the other's: (e * c, sites * b)."""
    count, basis = len(vectors), form_basis(contest)
    over_time = (vectors[:, :, None, :] * basis.T).transpose(0, 2, 1, 3).reshape(count, basis.shape[1], -1)
    at_sensors = np.zeros((count, contest.m, contest.sites, contest.b))
    responses = contest.responses(vectors)
    for j in range(contest.m):
        at_sensors[:, j, contest.k + j] = responses[:, :, j]
    both = np.concatenate([over_time, at_sensors.reshape(count, contest.m, -1)], axis=1)
    found: Array = both.reshape(-1, both.shape[2])
    return found
