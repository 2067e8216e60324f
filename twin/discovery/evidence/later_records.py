"""Ranking of hypotheses by records made later: each must explain them too, at about the size that it had.

If even the best leaves more than noise, its misfit replaces the variance (quasi-likelihood; McCullagh & Nelder,
Generalized Linear Models, 2nd ed., sec. 9.2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.evidence.finding import Finding, Ranked
from twin.discovery.evidence.part import Part
from twin.discovery.planning.design import from_the_start
from twin.discovery.refit.fitting import Fit, fit
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import validate
from twin.discovery.scoring.search import Entry

SAME_SIZE = 0.05
"""Relative difference of an effect's sizes in two records that has no cost."""
MORE_LEFT, MORE_SHARE = 4.0, 0.1
"""Misfit that the answer may leave in a later record, relative to noise alone or to the misfit before. Its steps are
larger than those of the record from which the noise was learned."""


def reranked(finding: Finding, first: Part, later: Sequence[Part]) -> tuple[Finding, tuple[str, ...]]:
    """Return the finding with its hypotheses ranked by all records, and sentences about the later ones.

    Score and cross-validation folds of the answer stay those of the first record.
    """
    each = weigh(finding.ranked, later, finding.score_test.grid.span_s)
    for part in later:
        part.reset()
    odds = np.array(
        [
            math.log(max(r.weight, 1e-300)) - 0.5 * (w.fit.total - r.fit.total)
            for r, w in zip(finding.ranked, each, strict=True)
        ]
    )
    shares = np.exp(odds - odds.max())
    shares /= shares.sum()
    order = np.argsort(-odds)
    evidence_later = [0.5 * (r.fit.total - w.fit.total) for r, w in zip(finding.ranked, each, strict=True)]
    ranked = tuple(
        Ranked(each[i].fit, -2.0 * float(odds[i]), float(shares[i]), finding.ranked[i].log_bayes + evidence_later[i])
        for i in order
    )
    at = int(order[0])
    best = finding.ranked[at].fit
    notes = [
        f"with the answer, later record {number} still leaves {chi:.2f} of misfit where noise alone leaves "
        f"{part.score_test.expected:.2f}; there is more in it, so diagnose that record by itself"
        for number, (chi, part) in enumerate(zip(each[at].chis, later, strict=True), start=1)
        if chi > max(MORE_LEFT * part.score_test.expected, MORE_SHARE * part.score_test.chi)
    ]
    same = at == 0
    folds = finding.folds if same else validate(first.score_test, Model.of(first.basis.probe, best.entries), best)
    first.reset()
    reported = finding.fit if same else best
    return replace(finding, ranked=ranked, fit=reported, entries=best.entries, folds=folds), tuple(notes)


@dataclass(frozen=True)
class RerankedHypothesis:
    """Hypothesis over all records: `fit` of the first record with the total of all; `chis` (parts,): misfit in each
    later one.
    """

    fit: Fit
    chis: tuple[float, ...]


def weigh(ranked: Sequence[Ranked], parts: Sequence[Part], span_s: float) -> list[RerankedHypothesis]:
    """Evaluate each hypothesis over all records; in later ones its effects are present throughout, at their final
    sizes.

    Args:
        span_s: length of the first record, at whose end the effects have those sizes.
    """
    totals = [hypothesis.fit.total for hypothesis in ranked]
    chis: list[list[float]] = [[] for _ in ranked]
    for part in parts:
        laws = {law.candidate.id: law for law in part.laws}
        costs = []
        for i, hypothesis in enumerate(ranked):
            # An effect that does nothing in a later record leaves the twin as it is there.
            before = [e for e in hypothesis.entries if e.candidate.id in laws]
            grown = [e.shape.entered.mean(span_s - 1.0, span_s) for e in before]
            entries = tuple(
                from_the_start(replace(e, law=laws[e.candidate.id]), share * e.size).refreshed(part.score_test)
                for e, share in zip(before, grown, strict=True)
            )
            part.reset()
            fitted = fit(part.score_test, Model.of(part.score_test.probe, entries), part.state)
            sizes = zip(before, grown, fitted.entries, strict=True)
            costs.append(fitted.total + sum(_apart(e, share, later) for e, share, later in sizes))
            chis[i].append(fitted.chi)
        # What even the best leaves over noise is the twin's own error: differences count by as much less.
        excess = max(min(chi[-1] for chi in chis) / part.score_test.expected, 1.0)
        totals = [total + cost / excess for total, cost in zip(totals, costs, strict=True)]
    return [
        RerankedHypothesis(replace(hypothesis.fit, total=total), tuple(chi))
        for hypothesis, total, chi in zip(ranked, totals, chis, strict=True)
    ]


def _apart(first: Entry, grown: float, later: Entry) -> float:
    """Return the cost, in weighted squares, of unequal sizes of one effect; of the first its `grown` share."""
    size, sd = grown * first.size, grown * first.sd
    spread = sd**2 + later.sd**2 + (SAME_SIZE * size) ** 2
    return (size - later.size) ** 2 / max(spread, 1e-30)
