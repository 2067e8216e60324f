"""How much of a record the fits may see, and what of the hypotheses is told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from twin.discovery.evidence.priors import CLAIM
from twin.discovery.evidence.scan import logsumexp, scan
from twin.discovery.evidence.search import Found, Hypothesis, Prior, ladder_of, searched
from twin.discovery.refit.fitting import Fit
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import validate
from twin.discovery.selection.inquiry import LATE, STILL_HELD, Answer, Inquiry
from twin.discovery.selection.part import Part, plainly
from twin.discovery.selection.ranking import Finding, Ranked


class EvidenceInquiry(Inquiry):
    """Inquiry whose answers are those of the search by evidence."""

    def answer(self, held_out: float) -> Answer:
        """The effects that are told, and what was kept out of their fit.

        Args:
            held_out: share of the record, at its end, that no fit sees, unless it holds what the rest does not show.
        """
        bins = len(self.grid.time)
        split = int(bins * (1.0 - held_out))
        most = max(split, int(bins * (1.0 - held_out * STILL_HELD)))
        prior = Prior(self.whole.laws)
        entries = scan(self.whole.contest, self.whole.laws)
        first = max(entries, key=lambda e: e.log_bayes + prior.of(e), default=None)
        odds = -math.inf if first is None else first.log_bayes + prior.of(first)
        notes: tuple[str, ...] = ()
        if first is not None and odds > CLAIM and first.shape.onset_s > LATE * split * self.grid.step_s:
            split = max(self._amid(first), split)
            notes = (
                f"something changed at {first.shape.onset_s / 3600.0:.1f} h, inside the part that was to be kept out "
                f"of the fit; the fit was given the record up to {self._hours(split)}",
            )
        found = self._by_evidence(split)
        missed = found.finding.fit is None and odds > CLAIM
        wrong = found.finding.fit is not None and self._held_out.far_off(found.finding, split)
        if (missed or wrong) and most > split:
            fuller = self._by_evidence(most)
            if fuller.finding.fit is not None and (missed or self._left(fuller) < self._left(found, most)):
                found = fuller
                notes = (
                    "the part that was to be kept out of the fit showed what the rest did not; so the fit was given "
                    f"the record up to {self._hours(most)}",
                )
        return replace(found, notes=notes)

    def _left(self, answer: Answer, split: int | None = None) -> float:
        return self._held_out.left(answer.finding, answer.split if split is None else split)

    def _by_evidence(self, split: int) -> Answer:
        train = self._train(split)
        return Answer(finding_of(searched(train, self.say), train), train, split, False)


def finding_of(found: Found, part: Part) -> Finding:
    """Return what is told of hypotheses: the likeliest, where its odds allow a claim."""
    contest = part.contest
    part.reset()
    best = found.told
    claimed = best is not None and best.odds >= CLAIM and best.odds >= found.unlisted
    ranked = _ranked(found, best) if claimed and best is not None else ()
    finding = Finding(
        entries=(), fit=None, retuned=plainly(part, found.retuned), ranked=(), scanned=tuple(part.entries),
        start=contest.misfit, count=contest.count, ladder=ladder_of(part, best if claimed else None),
        contest=contest, state=part.state, null=part.null,
        odds=max((h.odds for h in found.hypotheses), default=-math.inf), unlisted=found.unlisted,
    )  # fmt: skip
    if not claimed:
        return finding
    assert best is not None and best.fit is not None
    folds = validate(contest, Model.of(part.basis.probe, best.fit.entries), best.fit)
    part.reset()
    used = _as_used(best, part)
    return replace(finding, entries=best.fit.entries, fit=used, ranked=ranked, folds=folds)


def _ranked(found: Found, best: Hypothesis) -> tuple[Ranked, ...]:
    """The fitted hypotheses of as many effects by their share; those with more are the same with a better form."""
    rivals = [h for h in found.hypotheses if h.fit is not None and len(h.entries) <= len(best.entries)]
    odds = np.array([h.odds for h in rivals])
    weights = np.exp(odds - logsumexp(odds))
    order = sorted(range(len(rivals)), key=lambda i: (rivals[i] is not best, -odds[i]))
    return tuple(
        Ranked(fit, -2.0 * float(odds[i]), float(weights[i]), rivals[i].log_bayes)
        for i in order
        if (fit := rivals[i].fit) is not None
    )


def _as_used(best: Hypothesis, part: Part) -> Fit:
    """The fit with values that predict best by themselves: a twin does not know what its structure leaves."""
    found = best.fit
    assert found is not None
    used = plainly(part, found)
    same = all(a.size * b.size > 0.0 for a, b in zip(used.entries, found.entries, strict=True))
    return replace(used, total=found.total, chi=found.chi) if same else found
