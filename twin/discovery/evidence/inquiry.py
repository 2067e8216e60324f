"""How much of a record the fits may see, and what of the hypotheses is told."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.discovery.evidence.marginal import joint
from twin.discovery.evidence.priors import CLAIM, FAULT, SURE, UNLISTED
from twin.discovery.evidence.scan import logsumexp, scan
from twin.discovery.evidence.search import Found, Hypothesis, Prior, apart, ladder_of, searched
from twin.discovery.refit.fitting import AGAIN, Fit, look_at
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import validate
from twin.discovery.scoring.search import Entry
from twin.discovery.selection.inquiry import LATE, STILL_HELD, Answer, Inquiry
from twin.discovery.selection.part import Part, fitted, plainly
from twin.discovery.selection.ranking import Finding, Ranked
from twin.gauss_newton import SE90


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
        beside = self._beside(found.finding, prior, CLAIM)
        later = 0 if beside is None else max(most, self._amid(beside))
        if later > found.split:
            fuller = self._by_evidence(later)
            more = len(fuller.finding.entries) > len(found.finding.entries)
            if more and self._left(fuller) < self._left(found, later):
                found = fuller
                notes = (
                    "beside the answer, the part that was to be kept out of the fit showed more; so the fit was given "
                    f"the record up to {self._hours(later)}",
                )
        return replace(found, notes=notes)

    def _beside(self, finding: Finding, prior: Prior, claim: float) -> Entry | None:
        """Return the likeliest effect of the whole record beside those found in a part of it, if its odds allow a
        claim."""
        entries = finding.together or finding.entries
        if not entries:
            return None
        whole = self.whole
        whole.know(e.candidate for e in entries)
        laws = {law.candidate.id: law for law in whole.laws}
        here = tuple(replace(e, law=laws[e.candidate.id]).refreshed(whole.contest) for e in entries)
        ((fit, _),) = fitted(whole, [here], AGAIN)
        contest = copy.copy(whole.contest)
        look_at(contest, Model.of(contest.probe, fit.entries), fit)
        known = joint(contest, tuple(e.refreshed(contest) for e in fit.entries))
        found = [e for e in scan(contest, whole.laws, known, timed=False) if apart(e, fit.entries)]
        best = max(found, key=lambda e: e.log_bayes + prior.of(e), default=None)
        return best if best is not None and best.log_bayes + prior.of(best) > claim else None

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
    together = None
    if claimed and best is not None and best.fit is not None:
        together = coinciding(best.fit.entries, contest.grid.span_s, contest.grid.step_s)
    claimed = claimed and together is None
    ranked = _ranked(found, best) if claimed and best is not None else ()
    finding = Finding(
        entries=(), fit=None, retuned=plainly(part, found.retuned), ranked=(), scanned=tuple(part.entries),
        start=contest.misfit, count=contest.count, ladder=ladder_of(part, best if claimed else None),
        contest=contest, state=part.state, null=part.null,
        odds=max((h.odds for h in found.hypotheses), default=-math.inf), unlisted=found.unlisted,
        together=together,
    )  # fmt: skip
    if not claimed:
        return finding
    assert best is not None and best.fit is not None
    folds = validate(contest, Model.of(part.basis.probe, best.fit.entries), best.fit)
    part.reset()
    used = _as_used(best, part)
    return replace(finding, entries=best.fit.entries, fit=used, ranked=ranked, folds=folds)


def coinciding(entries: Sequence[Entry], span_s: float, step_s: float) -> tuple[Entry, Entry] | None:
    """Return two effects that begin so close together that one cause of no listed form is likelier than two; or None.

    Of two independent faults, the second begins by chance within d of the first with probability 2 d / span.
    """
    least = math.log(SURE / (1.0 - SURE))
    late = [e for e in entries if e.shape.onset_s > step_s]
    for one, other in itertools.combinations(late, 2):
        apart_s = abs(one.shape.onset_s - other.shape.onset_s)
        within_s = max(apart_s, SE90 * math.hypot(one.onset_sd_s, other.onset_sd_s), step_s)
        if math.log(UNLISTED / FAULT) + math.log(span_s / (2.0 * within_s)) > least:
            return one, other
    return None


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
