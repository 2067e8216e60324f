"""Laws that a twin lacked already in health: the rival explanation of every effect present from a record's beginning.

A set of hypotheses may hold effects, of which the healthy record has nothing, and laws that were always missing, about
which the healthy record is informative (`HealthyResidual`). Both have linear-Gaussian evidence in one quadratic form;
the healthy record gives the prior of a law's amplitude. The laws of the likeliest set join the twin's known structure
before effects are searched. Thus the lag of a stratified tank is no sensor fault, as far as the lag was the same in
health.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from twin.discovery.effects.laws import temperatures
from twin.discovery.effects.open_laws.laws import laws_of, open_laws
from twin.discovery.evidence.hypotheses import Prior, apart
from twin.discovery.evidence.marginal import Joint, joint, log_widths, widths
from twin.discovery.evidence.part import Part
from twin.discovery.evidence.priors import CLAIM, FAULT, FORM_ERRORS, MISSING_IN_HEALTH, SPREAD
from twin.discovery.evidence.scan import scan
from twin.discovery.evidence.search import leading, log_odds_unlisted, with_nonlinear
from twin.discovery.healthy.basis import Basis
from twin.discovery.healthy.law_amplitudes import Amplitudes, HealthyResidual, MissingInHealth
from twin.discovery.refit.fitting import Fit
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.structure import OF_TIME, Structure
from twin.elements.candidates import Candidate
from twin.network import Array

MOST_LACKED = 3.0
"""Largest share that a commissioned twin may have lacked, in standard deviations of its prior, of which 99.7 % is
within. A judgement."""
MOST_LAWS, BEAM = 5, 6
"""Members of a set at most, beside given ones, and sets of each count in the beam. Judgements that bound the time: sets
of five are common on the zoo's development families, and more were not tried."""


@dataclass(frozen=True)
class _Columns:
    """Effects and then laws as columns of one quadratic form.

    Attributes:
        gram: (c, c) of the record. score: (c,). precision: (c, c) of the prior. pull: (c,) precision @ prior mean.
        log_prior: (c,) with the part of each one's evidence that is not Gaussian.
    """

    gram: Array
    score: Array
    precision: Array
    pull: Array
    log_prior: Array

    def odds(self, sets: NDArray[np.intp]) -> Array:
        """Return the log posterior odds (n,) of sets (n, c) of as many columns each against none."""
        rows = sets[:, :, None], sets[:, None, :]
        inverse, gram = np.linalg.inv(self.precision[rows]), self.gram[rows]
        mean = (inverse @ self.pull[sets][:, :, None])[:, :, 0]
        score, expected = self.score[sets], (gram @ mean[:, :, None])[:, :, 0]
        left = score - expected
        inner = np.eye(sets.shape[1]) + inverse @ gram
        found = (mean * (score - 0.5 * expected)).sum(axis=1)
        found += 0.5 * (left * np.linalg.solve(inner, inverse @ left[:, :, None])[:, :, 0]).sum(axis=1)
        found += self.log_prior[sets].sum(axis=1) - 0.5 * np.linalg.slogdet(inner)[1]
        return np.asarray(found, dtype=np.float64)

    def sizes(self, which: Sequence[int]) -> Array:
        """Return the posterior means (n,) of a set."""
        at = list(which)
        both = (self.precision + self.gram)[np.ix_(at, at)]
        return np.asarray(np.linalg.solve(both, (self.pull + self.score)[at]), dtype=np.float64)

    def likeliest(self, given: Sequence[int], others: Sequence[int]) -> tuple[tuple[int, ...], float]:
        """Return the likeliest set with all `given` and some of the `others`, and its log odds."""
        best = tuple(given)
        most, level = float(self.odds(np.array([best]))[0]) if best else 0.0, [best]
        for _ in range(MOST_LAWS):
            grown = list({tuple(sorted((*s, i))): None for s in level for i in others if i not in s})
            if not grown:
                break
            odds = self.odds(np.array(grown))
            order = np.argsort(-odds, kind="stable")[:BEAM]
            level = [grown[i] for i in order]
            if odds[order[0]] <= most:
                break
            best, most = level[0], float(odds[order[0]])
        return best, most


def with_missing(part: Part) -> Basis:
    """Return the prior knowledge of a rig, with laws that the twin lacked already in health.

    They are added if laws alone are likelier than effects alone. Form errors are not part of this comparison, in which
    laws would correct those of a strong effect.

    Args:
        part: all of the record.
    """
    known = part.basis
    if known.health is None or known.structure is None or not part.scanned:
        return known
    prior, effects = Prior(part.laws), _leading_effects(part)
    amounts = known.health.amplitudes(
        [law.candidate for law in part.laws if not law.candidate.has_level], known.probe.scaling.ids
    )
    amounts = amounts.of(_by_structure_or_health(amounts))
    if not amounts.candidates:
        return known
    columns, count = _columns_of(part, part.score_test, effects, amounts, prior), len(effects)
    alone, odds = _possible(columns, (), amounts.candidates)
    if odds <= max(columns.likeliest((), range(count))[1], 0.0, *log_odds_unlisted(part).values()):
        return known
    # Laws that only stand for an effect that began later would hide it: beside it, fewer laws may do.
    begun = [i for i, e in enumerate(effects) if e.shape.onset_s > 0.0]
    likeliest, beside = _possible(columns, begun, amounts.candidates)
    if beside <= odds + CLAIM:
        likeliest = alone
    if all(i < count for i in likeliest) or odds < _odds_of_nonlinear(part, prior):
        return known
    return _joined(known, known.structure, columns, amounts, likeliest)


def with_missing_beside(part: Part, fit: Fit, further: Sequence[Entry]) -> Basis:
    """Return the prior knowledge of a rig, with laws that are likelier than the `further` effects beside a fitted one.

    A record may take the rig to where it never was in health. What a lumped twin lacks shows there, and beside a large
    effect resembles a second one. A law of which the healthy record says nothing may always have been missing, too.

    Args:
        part: all of the record, with the laws of the effects of the `fit` and of the further ones.
    """
    known = part.basis
    if known.health is None or known.structure is None:
        return known
    candidates = [law.candidate for law in part.laws if not law.candidate.has_level]
    amounts = _amounts_of(known, known.health, candidates)
    if known.earlier is None:
        amounts = amounts.with_unknown([c for c in candidates if not c.is_open])
    amounts = amounts.of(_by_structure_or_health(amounts))
    if not amounts.candidates:
        return known
    prior, score_test = Prior([*part.laws, *part.open_candidates]), copy.copy(part.score_test)
    score_test.take(fit.residual, fit.moved)
    beside = joint(score_test, tuple(e.refreshed(score_test) for e in fit.entries))
    columns, count = _columns_of(part, score_test, further, amounts, prior, beside), len(further)
    likeliest, odds = _possible(columns, (), amounts.candidates, amounts)
    if odds <= max(float(columns.odds(np.arange(count)[None])[0]), 0.0):
        return known
    return _joined(known, known.structure, columns, amounts, likeliest)


def _joined(
    known: Basis, structure: Structure, columns: _Columns, amounts: Amplitudes, likeliest: Sequence[int]
) -> Basis:
    """Return the prior knowledge of a rig with the laws of the `likeliest` columns as part of the known structure."""
    count = len(columns.score) - len(amounts.candidates)
    at = [i for i in likeliest if i >= count]
    which = [i - count for i in at]
    covariance = np.asarray(np.linalg.inv(columns.precision[np.ix_(at, at)]), dtype=np.float64)
    missing = tuple(amounts.candidates[i] for i in which)
    structure = structure.with_laws(missing, covariance @ columns.pull[at], covariance, amounts.moves[:, which])
    sizes = columns.sizes(likeliest)[[likeliest.index(i) for i in at]]
    before = known.missing or MissingInHealth((), np.zeros(0))
    all_missing = MissingInHealth((*before.candidates, *missing), np.concatenate([before.sizes, sizes]))
    return replace(known, structure=structure, missing=all_missing)


def _possible(
    columns: _Columns, begun: Sequence[int], laws: Sequence[Candidate], amounts: Amplitudes | None = None
) -> tuple[tuple[int, ...], float]:
    """Return the likeliest set of the effects `begun` and of laws, the last columns, with sizes within their bounds.

    Args:
        amounts: of the laws in the healthy record, which by itself must not rule out the set, whatever the present
            record gains by it.
    """
    first = len(columns.score) - len(laws)
    others = [*begun, *range(first, len(columns.score))]
    while True:
        found, odds = columns.likeliest((), others)
        sizes = columns.sizes(found)
        of_laws = {i: float(size) for i, size in zip(found, sizes, strict=True) if i >= first}
        outside = {i for i, size in of_laws.items() if not _may_lack(laws[i - first], size)}
        if not outside and amounts is not None and of_laws:
            every = np.zeros(len(laws))
            every[[i - first for i in of_laws]] = [*of_laws.values()]
            if amounts.log_ratio(every) < -CLAIM:
                outside = {
                    min(
                        of_laws,
                        key=lambda i: amounts.log_ratio(np.where(np.arange(len(laws)) == i - first, every, 0.0)),
                    )
                }
        if not outside:
            return found, odds
        others = [i for i in others if i not in outside]


def _by_structure_or_health(amounts: Amplitudes) -> list[int]:
    """Return the laws that a twin may have lacked in health.

    A lumped twin lacks what follows temperatures, flows and commands. Heat that follows the clock comes from outside,
    as a fault does: that the healthy record had no such hours does not make it usual. It has to show in that record.
    """
    found = []
    for i, law in enumerate(amounts.candidates):
        width = SPREAD * law.typical
        precision = float(amounts.precision[i, i])
        gain = 0.5 * float(amounts.score[i]) ** 2 / (precision + width**-2.0)
        shown = math.log(FAULT) + gain - 0.5 * math.log1p(precision * width**2) > 0.0
        if law.driver not in OF_TIME or shown:
            found.append(i)
    return found


def _may_lack(law: Candidate, size: float) -> bool:
    """Return True if a commissioned twin may have lacked a law of a size within its bounds and, for a share, its prior.

    A pump that delivers a tenth of its command is seen in commissioning, and so is a bypass of nearly all of the flow.
    Sizes with units differ by the orders of rigs, and have no such limit.
    """
    is_share = law.unit == "1" or law.unit.startswith("of ")
    return law.lower <= size <= law.upper and (not is_share or abs(size) <= MOST_LACKED * SPREAD * law.typical)


def with_usual(known: Basis, entries: Sequence[Entry]) -> Basis:
    """Return the prior knowledge of a rig, with effects of an answer that were already present in health.

    An effect present from the beginning is likelier a law that was always missing if the healthy record's amplitude,
    within a form error, is nearer to the fitted one than the prior of a fault is.
    """
    named = [e for e in entries if not e.candidate.has_level]
    along = [e for e in named if e.shape.name == "step" and e.shape.onset_s <= 0.0]
    if known.health is None or known.structure is None or not along:
        return known
    missing = known.missing
    for entry in along:
        amounts = _amounts_of(known, known.health, [entry.candidate])
        if not amounts.candidates:
            continue
        wide = float(widths(entry.candidate.typical, entry.size)) ** 2
        variance = 1.0 / (float(amounts.precision[0, 0]) + 1.0 / wide)
        mean = variance * float(amounts.score[0])
        variance += (max(FORM_ERRORS) * mean) ** 2
        before = math.log(MISSING_IN_HEALTH) + _log_normal(entry.size - mean, variance + entry.sd**2)
        fault = math.log(FAULT) - log_widths([entry.candidate], np.array([entry.size]))
        if before > fault + _log_normal(entry.size, wide + entry.sd**2):
            structure, law = known.structure, (entry.candidate,)
            assert structure is not None
            structure = structure.with_laws(law, np.array([mean]), np.array([[variance]]), amounts.moves)
            earlier = missing or MissingInHealth((), np.zeros(0))
            missing = MissingInHealth((*earlier.candidates, *law), np.append(earlier.sizes, entry.size))
            known = replace(known, structure=structure, missing=missing)
    return known


def _amounts_of(known: Basis, health: HealthyResidual, candidates: Sequence[Candidate]) -> Amplitudes:
    """Return the amplitudes of laws in the healthy record; none where the twin then lacked what they are made of."""
    ids, book, network = known.probe.scaling.ids, health.book, known.probe.network
    named, open_candidates = ([c for c in candidates if c.is_open is is_open] for is_open in (False, True))
    if known.earlier is not None:
        return health.amplitudes(named, ids)
    laws = book.laws(health.grid, health.run, tuple(named)) if named else []
    if open_candidates:
        here = temperatures(network, health.grid, health.run)
        every = open_laws(network, health.grid, book.laws(health.grid, health.run), here)
        laws = [*laws, *laws_of(network, open_candidates, every, health.grid, here)]
    return health.amplitudes_of(laws, ids)


def _log_normal(off: float, variance: float) -> float:
    return -0.5 * (off**2 / variance + math.log(2.0 * math.pi * variance))


def _columns_of(
    part: Part,
    score_test: ScoreTest,
    effects: Sequence[Entry],
    amounts: Amplitudes,
    prior: Prior,
    beside: Joint | None = None,
) -> _Columns:
    """Return effects, and then the laws with amplitudes `amounts` in the healthy record, as columns of one quadratic
    form, in which the effects `beside` are integrated out.
    """
    by = {law.candidate.id: law for law in part.laws}
    here = score_test.signatures(np.stack([score_test.vector(by[c.id]) for c in amounts.candidates]))
    here += score_test.slopes[:, : part.basis.probe.q] @ amounts.moves
    there = score_test.signatures(np.array([e.vector for e in effects]).reshape(-1, score_test.sites, score_test.b))
    seen = np.concatenate([there, here], axis=1)
    _, gram, score = score_test.beside_tunables(seen)
    if beside is not None:
        gram, score = beside.reduced(seen, gram, score)
    sizes = np.array([e.size for e in effects])
    wide = [
        *widths(np.array([e.candidate.typical for e in effects]), sizes) ** -2.0,
        *((SPREAD * c.typical) ** -2.0 for c in amounts.candidates),
    ]
    count = len(effects)
    missing = [math.log(MISSING_IN_HEALTH) + prior.share(c) for c in amounts.candidates]
    columns = _Columns(
        gram=gram,
        score=score,
        precision=block_diag(np.zeros((count, count)), amounts.precision) + np.diag(wide),
        pull=np.concatenate([np.zeros(count), amounts.score]),
        log_prior=np.array([prior.of(e) + e.log_occam for e in effects] + missing),
    )
    # Beside others an effect was scanned without them, so that its own evidence says nothing here.
    for i, entry in enumerate(effects if beside is None else ()):
        # What bounds and unknown times make of an effect's evidence is no matter of its neighbours.
        columns.log_prior[i] += entry.log_bayes + prior.of(entry) - float(columns.odds(np.array([[i]]))[0])
    return columns


def _odds_of_nonlinear(part: Part, prior: Prior) -> float:
    """Return the log odds of the likeliest lag or delay once fitted; its linear estimate is too small."""
    part.reset()
    found = with_nonlinear(part, [], prior, part.score_test.misfit)
    part.reset()
    return max((h.odds for h in found), default=-math.inf)


def _leading_effects(part: Part) -> list[Entry]:
    """Return the leading single effects, and those beside the likeliest."""
    score_test, prior = part.score_test, Prior(part.laws)
    first = leading(part.scanned, prior)
    others = [law for law in part.laws if apart(law.candidate, first[:1])]
    return [*first, *leading(scan(score_test, others, joint(score_test, first[:1]), transient=False), prior)]
