"""The rival of every effect that is there from a record's beginning: the twin lacked a law in health already.

A set of hypotheses may hold effects, which the healthy record has nothing of, and laws that were missing all along, of
which it says as much as it can (`InHealth`). Both have linear-Gaussian evidence in the same quadratic form; a law's
amplitude has what the healthy record says as its prior. The laws of the likeliest set become part of the twin's known
structure, beside which effects are looked for. So the lag of a tank that is stratified is no sensor that has become
slow, as far as it was as slow in health.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from twin.discovery.effects.shapes import EARLY_S
from twin.discovery.evidence.marginal import joint
from twin.discovery.evidence.part import Part, fitted
from twin.discovery.evidence.priors import MISSING_IN_HEALTH, SPREAD
from twin.discovery.evidence.scan import scan
from twin.discovery.evidence.search import Prior, apart, late_ones, leading
from twin.discovery.healthy.basis import Basis
from twin.discovery.healthy.in_health import MissingInHealth
from twin.discovery.refit.fitting import AGAIN, look_at
from twin.discovery.refit.model import Model
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.search import Entry
from twin.network import Array

MOST_LAWS, BEAM = 5, 6
"""Members of a set beside given ones, and sets of as many members that are gone on with."""


@dataclass(frozen=True)
class _Columns:
    """Effects and then laws as columns of one quadratic form.

    Attributes:
        gram: (c, c) of the record. score: (c,). precision: (c, c) before the record. pull: (c,) precision @ mean.
        log_prior: (c,) with what is not Gaussian of each one's evidence.
    """

    gram: Array
    score: Array
    precision: Array
    pull: Array
    log_prior: Array

    def odds(self, which: Sequence[int]) -> float:
        """Return the log posterior odds of a set against none."""
        at = list(which)
        inverse = np.linalg.inv(self.precision[np.ix_(at, at)])
        mean, gram = inverse @ self.pull[at], self.gram[np.ix_(at, at)]
        left = self.score[at] - gram @ mean
        inner = np.eye(len(at)) + inverse @ gram
        found = mean @ self.score[at] - 0.5 * mean @ gram @ mean
        found += 0.5 * left @ np.linalg.solve(inner, inverse @ left) - 0.5 * np.linalg.slogdet(inner)[1]
        return float(found + self.log_prior[at].sum())

    def sizes(self, which: Sequence[int]) -> Array:
        """Return the posterior means (n,) of a set."""
        at = list(which)
        both = (self.precision + self.gram)[np.ix_(at, at)]
        return np.asarray(np.linalg.solve(both, (self.pull + self.score)[at]), dtype=np.float64)

    def likeliest(self, given: Sequence[int], others: Sequence[int]) -> tuple[tuple[int, ...], float]:
        """Return the likeliest set that holds what is `given` and some of the `others`, and its log odds."""
        best = tuple(given)
        most, level = self.odds(best) if best else 0.0, [best]
        for _ in range(MOST_LAWS):
            grown = {tuple(sorted((*s, i))) for s in level for i in others if i not in s}
            odds = {s: self.odds(s) for s in grown}
            level = sorted(odds, key=lambda s: -odds[s])[:BEAM]
            if not level or odds[level[0]] <= most:
                break
            best, most = level[0], odds[level[0]]
        return best, most


def with_missing(part: Part) -> Basis:
    """Return what is known of a rig, with laws that the twin lacked in health already where they alone are likeliest.

    Args:
        part: all of the record.
    """
    effects = _leading_effects(part) if part.scanned else []
    return _beside(part, part.contest, effects, 0) if effects else part.basis


def with_missing_beside(part: Part, entries: Sequence[Entry]) -> Basis:
    """Return what is known of a rig, with laws that the twin lacked in health already where they are likelier than one
    of several effects that are there all along.

    Args:
        part: a part of a record. entries: effects found in it, with their sizes.
    """
    for i, entry in enumerate(entries):
        if len(entries) > 1 and entry.shape.onset_s <= EARLY_S:
            rest = (*entries[:i], *entries[i + 1 :])
            ((fit, _),) = fitted(part, [rest], AGAIN)
            contest = copy.copy(part.contest)
            look_at(contest, Model.of(contest.probe, fit.entries), fit)
            effects = [e.refreshed(contest) for e in (*fit.entries, entry)]
            found = _beside(part, contest, effects, len(rest))
            if found is not part.basis:
                return found
    return part.basis


def _beside(part: Part, contest: Contest, effects: Sequence[Entry], given: int) -> Basis:
    """Return what is known, with the laws that beside the first effects are likelier than the other effects."""
    known = part.basis
    if known.health is None or known.structure is None:
        return known
    prior = Prior(part.laws)
    amounts = known.health.amplitudes([law.candidate for law in part.laws], known.probe.scaling.ids)
    by = {law.candidate.id: law for law in part.laws}
    laws = [by[c.id] for c in amounts.candidates]
    if not laws:
        return known
    here = contest.signatures(np.stack([contest.vector(law) for law in laws]))
    here += contest.slopes[:, : known.probe.q] @ amounts.moves
    there = contest.signatures(np.stack([e.vector for e in effects]))
    _, gram, score = contest.beside_tunables(np.concatenate([there, here], axis=1))
    wide = [(SPREAD * c.typical) ** -2.0 for c in (*(e.candidate for e in effects), *amounts.candidates)]
    count = len(effects)
    columns = _Columns(
        gram=gram,
        score=score,
        precision=block_diag(np.zeros((count, count)), amounts.precision) + np.diag(wide),
        pull=np.concatenate([np.zeros(count), amounts.score]),
        log_prior=np.array(
            [prior.of(e) for e in effects] + [math.log(MISSING_IN_HEALTH) + prior.share(c) for c in amounts.candidates]
        ),
    )
    for i, entry in enumerate(effects[given:], given):
        # What bounds and unknown times make of an effect's evidence is no matter of its neighbours.
        columns.log_prior[i] += entry.log_occam if given else entry.log_bayes + prior.of(entry) - columns.odds((i,))
    held, more = range(given), range(given, count)
    by_laws, odds_of_laws = columns.likeliest(held, range(count, len(columns.score)))
    odds_of_effects = columns.likeliest(held, more)[1]
    if odds_of_laws <= max(odds_of_effects, 0.0) or (not given and odds_of_laws < _odds_of_late(part, prior)):
        return known
    best, _ = columns.likeliest(by_laws, more)
    laws_of = [i for i in best if i >= count]
    which = [i - count for i in laws_of]
    covariance = np.asarray(np.linalg.inv(columns.precision[np.ix_(laws_of, laws_of)]), dtype=np.float64)
    missing = [amounts.candidates[i] for i in which]
    structure = known.structure.with_laws(
        missing, covariance @ columns.pull[laws_of], covariance, amounts.moves[:, which]
    )
    found = MissingInHealth(tuple(missing), columns.sizes(best)[[best.index(i) for i in laws_of]])
    return replace(known, structure=structure, missing=found)


def _odds_of_late(part: Part, prior: Prior) -> float:
    """Return the log odds of the likeliest lag or delay once fitted, which to first order are told too small."""
    part.reset()
    found = late_ones(part, [], prior, part.contest.misfit)
    part.reset()
    return max((h.odds for h in found), default=-math.inf)


def _leading_effects(part: Part) -> list[Entry]:
    """Return the leading single effects, and those beside the likeliest."""
    contest, prior = part.contest, Prior(part.laws)
    first = leading(part.scanned, prior)
    beside = scan(contest, part.laws, joint(contest, first[:1]), timed=False)
    return [*first, *leading([e for e in beside if apart(e, tuple(first[:1]))], prior)]
