"""Search on a fitting segment of a record: choice of the held-out segment, and the finding."""

from __future__ import annotations

import copy
import itertools
import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.discovery.diagnosis import SensorError
from twin.discovery.evidence.commissioned import nothing
from twin.discovery.evidence.finding import Finding, Ranked
from twin.discovery.evidence.held_out import HeldOutRecord
from twin.discovery.evidence.hypotheses import Found, Hypothesis, Prior, apart, class_of
from twin.discovery.evidence.marginal import joint
from twin.discovery.evidence.missing_in_health import with_missing, with_missing_beside, with_usual
from twin.discovery.evidence.part import Part, fitted, plainly, within_commands
from twin.discovery.evidence.priors import CLAIM, COINCIDENT_SHARE, FAULT, SURE, UNLISTED
from twin.discovery.evidence.scan import logsumexp, scan
from twin.discovery.evidence.search import ladder_of, log_odds_unlisted, refitted, searched
from twin.discovery.healthy.basis import Basis, Columns
from twin.discovery.records.grid import Grid
from twin.discovery.refit.fitting import AGAIN, Fit
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import validate
from twin.discovery.scoring.record_noise import relative_covariances
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.structure import PLAIN
from twin.discovery.scoring.sweep import LAST_SHARE
from twin.elements.candidates import Candidate
from twin.network import Network
from twin.quantiles import NORMAL90

STILL_HELD = 0.4
"""Share of the held-out segment that stays held out if that segment shows an effect that the rest does not."""
WELL_SEEN, KEPT = LAST_SHARE - 0.01, 6
"""Share of a part within which a search finds an onset whatever its block edges, and bins that stay held out even then.
"""
LATE = 0.85
"""Share of the fitting segment beyond which an onset leaves too little of it to identify the effect."""


@dataclass(frozen=True)
class SplitFinding:
    """Finding in `train`, the record up to bin `split`."""

    finding: Finding
    train: Part
    split: int
    found: Found
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class SplitSearch:
    """Search of a record with prior knowledge of its rig; `say` is called with a description of each step.

    `begun` is all of the record as `known` has it, made by `of`.
    """

    network: Network
    record: Columns
    known: Basis
    grid: Grid
    begun: Part
    say: Callable[[str], None]

    @classmethod
    def of(cls, network: Network, record: Columns, known: Basis, grid: Grid, say: Callable[[str], None]) -> SplitSearch:
        """Return the search of a record, with the laws that the twin lacked already in health."""
        known = _with_own_noise(known, grid)
        begun = Part.of(known, grid)
        more = with_missing(begun)
        return cls(network, record, more, grid, begun if more is known else Part.of(more, grid), say)

    def settled(self, held_out: float) -> tuple[SplitSearch, SplitFinding]:
        """Return the answer (see `answer`), and the search that gave it.

        If an effect was already present in health, it becomes a law that the twin has always lacked, and the search
        restarts.
        """
        found = self.answer(held_out)
        known = with_usual(self._missing_beside(found.finding), found.finding.entries)
        if known is self.known:
            return self, found
        anew = replace(self, known=known, begun=Part.of(known, self.grid))
        return anew, anew.answer(held_out)

    def _missing_beside(self, finding: Finding) -> Basis:
        """Return the prior knowledge with laws that are likelier beside the surest effect than the further ones."""
        if len(finding.entries) < 2:
            return self.known
        first, *further = self._of_whole(finding.entries)
        ((fit, _),) = fitted(self.whole, [(first,)], AGAIN)
        return with_missing_beside(self.whole, fit, further)

    def _of_whole(self, entries: Sequence[Entry]) -> tuple[Entry, ...]:
        """Return effects of a part in the score test of the whole record."""
        whole = self.whole
        whole.know(e.candidate for e in entries)
        laws = {law.candidate.id: law for law in whole.laws}
        return tuple(replace(e, law=laws[e.candidate.id]).refreshed(whole.score_test) for e in entries)

    @cached_property
    def _scanned(self) -> tuple[Part, tuple[Candidate, ...]]:
        whole = self.begun
        forms = _nearer(whole)
        whole.add(forms)
        return whole, forms

    @property
    def whole(self) -> Part:
        """Return all of the record, for the scan; answers are fitted to the fitting segment."""
        return self._scanned[0]

    def part(self, grid: Grid) -> Part:
        """Return a part of the record, with the law forms of greatest evidence on all of it."""
        return self._with_forms(Part.of(self.known, grid))

    def further(self, grid: Grid) -> Part:
        """Return a further record with its own noise, and with the law forms of greatest evidence on this record."""
        return self._with_forms(Part.of(_with_own_noise(self.known, grid), grid))

    def _with_forms(self, made: Part) -> Part:
        made.add(self._scanned[1])
        return made

    def held_out_errors(self, finding: Finding, split: int) -> dict[str, SensorError]:
        """Return the errors of a finding from bin `split` on."""
        return self._held_out.errors(finding, split)

    @cached_property
    def _held_out(self) -> HeldOutRecord:
        return HeldOutRecord(self.network, self.record, self.grid, self.known.plain)

    def answer(self, held_out: float) -> SplitFinding:
        """Return the finding, and the bin at which its held-out segment begins.

        Args:
            held_out: share of the record, at its end, that is held out, unless it shows an effect that the rest does
                not.
        """
        bins = len(self.grid.time)
        split = int(bins * (1.0 - held_out))
        most = max(split, int(bins * (1.0 - held_out * STILL_HELD)))
        prior = Prior(self.whole.laws)
        first = max(self.whole.scanned, key=lambda e: e.log_bayes + prior.of(e), default=None)
        odds = -math.inf if first is None else first.log_bayes + prior.of(first)
        claim = max(CLAIM, self.known.claim)
        notes: tuple[str, ...] = ()
        if first is not None and odds > claim and first.shape.onset_s > LATE * split * self.grid.step_s:
            split = max(self._amid(first), split)
            notes = (
                f"something changed at {first.shape.onset_s / 3600.0:.1f} h, inside the part that was to be kept out "
                f"of the fit; the fit was given the record up to {self._hours(split)}",
            )
        found = self._searched(split)
        # An unknown of no listed form that is likelier than every named one lacks a form, not more of the record.
        formless = found.finding.unlisted > max(found.finding.odds, claim)
        missed = found.finding.fit is None and odds > claim and not formless
        wrong = found.finding.fit is not None and self._held_out.exceeds_usual(found.finding, split)
        # Where all of the record allows a claim, what shows in its very end alone is looked for there.
        tried: dict[int, SplitFinding] = {}
        for end in (most, bins - KEPT) if missed else (most,) if wrong else ():
            if end <= found.split:
                continue
            tried[end] = fuller = self._searched(end, found)
            if fuller.finding.fit is not None and (missed or self._left(fuller) < self._left(found, end)):
                found = fuller
                notes = (
                    "the part that was to be kept out of the fit showed what the rest did not; so the fit was given "
                    f"the record up to {self._hours(end)}",
                )
            if found is fuller or any(e.log_bayes + prior.of(e) > claim for e in fuller.found.scanned):
                break
        beside = self._beside(found.finding, prior, claim)
        later = 0 if beside is None else max(most, self._amid(beside))
        if later > found.split:
            fuller = tried.get(later) or self._searched(later, found)
            more = len(fuller.finding.entries) > len(found.finding.entries)
            if more and self._left(fuller) < self._left(found, later):
                found = fuller
                notes = (
                    "beside the answer, the part that was to be kept out of the fit showed more; so the fit was given "
                    f"the record up to {self._hours(later)}",
                )
        if found.finding.fit is not None and self._held_out.exceeds_usual(found.finding, found.split):
            found = replace(found, finding=self._against_unlisted(found.finding))
        return replace(found, notes=notes)

    def _against_unlisted(self, finding: Finding) -> Finding:
        """Return a finding, without its effects where one of no listed form is likelier on all of the record.

        The part that was fitted may have shown one turn only of an effect that comes again.
        """
        whole = self.whole
        whole.know(e.candidate for e in finding.entries)
        ((retuned, _),) = fitted(whole, [()])
        whole.reset()
        misfit = whole.score_test.misfit
        reported = refitted(whole, finding.entries, Prior(whole.laws, whole.open_candidates), misfit)
        nothing_odds = 0.5 * (misfit - retuned.total)
        unlisted = {at: odds - nothing_odds for at, odds in log_odds_unlisted(whole).items()}
        whole.reset()
        if reported is None:
            return finding
        reported = replace(reported, log_bayes=reported.log_bayes - nothing_odds)
        rival = Found((reported,), [], retuned, unlisted).rival_of(reported, whole.score_test.expected)
        if reported.odds >= max(rival, finding.claim):
            return finding
        return replace(nothing(finding), odds=min(reported.odds, finding.odds), unlisted=rival)

    def _beside(self, finding: Finding, prior: Prior, claim: float) -> Entry | None:
        """Return the likeliest effect of the whole record in addition to those of a part of it, if its odds allow a
        claim.
        """
        entries = finding.together or finding.entries
        if not entries:
            return None
        whole = self.whole
        ((fit, _),) = fitted(whole, [self._of_whole(entries)], AGAIN)
        score_test = copy.copy(whole.score_test)
        score_test.take(fit.residual, fit.moved)
        known = joint(score_test, tuple(e.refreshed(score_test) for e in fit.entries))
        others = [law for law in whole.laws if apart(law.candidate, fit.entries)]
        found = scan(score_test, others, known, transient=False)
        best = max(found, key=lambda e: e.log_bayes + prior.of(e), default=None)
        return best if best is not None and best.log_bayes + prior.of(best) > claim else None

    def _left(self, answer: SplitFinding, split: int | None = None) -> float:
        return self._held_out.left(answer.finding, answer.split if split is None else split)

    def _hours(self, split: int) -> str:
        return f"{split * self.grid.step_s / 3600.0:.1f} h"

    def _amid(self, entry: Entry) -> int:
        """Return the bin midway between an onset and the record's end, or the first from which a search finds that
        onset.
        """
        bins, onset = len(self.grid.time), entry.shape.onset_s / self.grid.step_s
        return min(max((int(onset) + bins) // 2, int(onset / WELL_SEEN)), bins - KEPT)

    def _searched(self, split: int, shorter: SplitFinding | None = None) -> SplitFinding:
        """Return the finding in the record up to bin `split`, given the effects of a shorter part."""
        whole = split >= len(self.grid.time)
        train = self.whole if whole else self.part(self.grid.part(0, split))
        found = searched(train, self.say, () if shorter is None else (shorter.finding.entries,))
        return SplitFinding(finding_of(found, train, self.grid.span_s), train, split, found)


def _with_own_noise(known: Basis, grid: Grid) -> Basis:
    """Return the prior knowledge with the noise of a record, of which the likeliest effect is no part."""
    if known.health is None:
        return known
    of_health = replace(known.noise, relative=None)
    part = Part.of(replace(known, noise=of_health), grid)
    likeliest = scan(part.score_test, part.laws, transient=False)[:1]
    effects = [e for e in likeliest if e.z > PLAIN]
    return replace(known, noise=replace(of_health, relative=relative_covariances(part.score_test, effects)))


def _nearer(part: Part) -> tuple[Candidate, ...]:
    """Return, for laws with many forms, those of greater evidence at each place than the catalogue's own."""
    first: dict[tuple[str, ...], Entry] = {}
    for entry in part.scanned:
        c = entry.candidate
        if c.near is not None:
            # Laws of other parameters may follow the same driver at one place.
            first.setdefault((c.kind, c.where, c.driver, *c.changes), entry)
    best = dict(first)
    forms = {key: _near(part, entry) for key, entry in first.items()}
    while forms:
        laws = {key: part.basis.book.laws(part.grid, part.run, those) for key, those in forms.items()}
        of = {id(law): key for key, those in laws.items() for law in those}
        nearer: dict[tuple[str, ...], Entry] = {}
        for entry in scan(part.score_test, [law for those in laws.values() for law in those]):
            nearer.setdefault(of[id(entry.law)], entry)
        better = {key: entry for key, entry in nearer.items() if entry.log_bayes > best[key].log_bayes}
        best |= better
        forms = {key: _near(part, entry) for key, entry in better.items()}
    return tuple(entry.candidate for key, entry in best.items() if entry is not first[key])


def _near(part: Part, entry: Entry) -> tuple[Candidate, ...]:
    """Return the similar forms of an entry's law that the part can tell."""
    return () if entry.candidate.near is None else within_commands(part, entry.candidate.near())


def finding_of(found: Found, part: Part, record_s: float) -> Finding:
    """Return the finding of a search: the likeliest hypothesis, if its odds allow a claim.

    One of two effects that begin at one moment is reported alone if the other may be its form error.

    Args:
        record_s: length of the record, s, to whose end an effect that still grows at the end of the part grows on.
    """
    score_test, claim = part.score_test, max(CLAIM, part.basis.claim)
    part.reset()
    best = _of_possible_sizes(found)
    least = max(claim, found.unlisted if best is None else found.rival_of(best, score_test.expected))
    together = _at_one_moment(best, score_test) if best is not None and best.odds >= least else None
    if together is not None and best is not None:
        # What comes back in the turns of another is certainly of one cause, whatever share of it the other has.
        same = _same_turns_by_chance(*together, score_test.grid.span_s) < 1.0
        enough = least if same else best.odds * (1.0 - COINCIDENT_SHARE)
        fewer_ones = with_fewer_effects(best, found.hypotheses, enough)
        others = [h for h in fewer_ones if _at_one_moment(h, score_test) is None]
        best = others[0] if others else best
    claimed = best is not None and best.odds >= least and _at_one_moment(best, score_test) is None
    ranked = _ranked(found, best) if claimed and best is not None else ()
    finding = Finding(
        entries=(),
        fit=None,
        retuned=plainly(part, found.retuned),
        ranked=ranked,
        scanned=tuple(found.scanned),
        start=score_test.misfit,
        count=score_test.count,
        ladder=ladder_of(part, best if claimed else None, found.scanned),
        score_test=score_test,
        state=part.state,
        claim=claim,
        odds=max((h.odds for h in found.hypotheses), default=-math.inf),
        unlisted=found.unlisted,
        together=together,
    )
    if not claimed:
        return finding
    assert best is not None and best.fit is not None
    # The effect that the data tell most surely is named first.
    fit = replace(best.fit, entries=tuple(sorted(best.fit.entries, key=lambda e: -abs(e.size) / max(e.sd, 1e-300))))
    folds = validate(score_test, Model.of(part.basis.probe, fit.entries), fit)
    part.reset()
    used = _as_used(fit, part)
    entries, grown = (
        tuple(e.going_on(part.grid.span_s, record_s) for e in those) for those in (fit.entries, used.entries)
    )
    return replace(finding, entries=entries, fit=replace(used, entries=grown), folds=folds)


def _of_possible_sizes(found: Found) -> Hypothesis | None:
    """Return the likeliest hypothesis, or one without those of its effects whose sizes end on a bound."""
    best = found.reported
    if best is None or not _on_a_bound(best):
        return best
    fewer = with_fewer_effects(best, found.hypotheses, -math.inf)
    return max((h for h in fewer if not _on_a_bound(h)), key=lambda h: h.odds, default=best)


def _on_a_bound(h: Hypothesis) -> bool:
    return any(e.on_bound for e in h.entries)


def with_fewer_effects(best: Hypothesis, hypotheses: Sequence[Hypothesis], enough: float) -> list[Hypothesis]:
    """Return the fitted hypotheses of log odds `enough` or more with a proper subset of the classes of `best`."""
    classes = Counter(map(class_of, best.entries))
    fits = [h for h in hypotheses if h.fit is not None and h.odds >= enough]
    return [h for h in fits if Counter(map(class_of, h.entries)) < classes]


def _at_one_moment(h: Hypothesis | None, score_test: ScoreTest) -> tuple[Entry, Entry] | None:
    """Return two effects of a hypothesis that are likelier one effect of no listed form; or None."""
    return None if h is None else coinciding(h.entries, score_test.grid.span_s, score_test.grid.step_s)


def coinciding(entries: Sequence[Entry], span_s: float, step_s: float) -> tuple[Entry, Entry] | None:
    """Return two effects with the same onset or period, for which one cause of no listed form is likelier; or None.

    Of two independent faults, the second begins by chance within d of the first with probability 2 d / span. Two
    periodic ones have the same periods in the whole record by chance with probability 2 period / span.
    """
    least = math.log(SURE / (1.0 - SURE))
    for one, other in itertools.combinations(entries, 2):
        by_chance = _same_turns_by_chance(one, other, span_s)
        if min(one.shape.onset_s, other.shape.onset_s) > step_s:
            apart_s = abs(one.shape.onset_s - other.shape.onset_s)
            within_s = max(apart_s, NORMAL90 * math.hypot(one.onset_sd_s, other.onset_sd_s), step_s)
            by_chance = min(by_chance, 2.0 * within_s / span_s)
        if math.log(UNLISTED / FAULT) - math.log(by_chance) > least:
            return one, other
    return None


def _same_turns_by_chance(one: Entry, other: Entry, span_s: float) -> float:
    """Return the probability that two effects have the same period by chance; 1 if they do not."""
    a, b = one.shape, other.shape
    if a.name != "periodic" or b.name != "periodic" or abs(1.0 / a.growth_s - 1.0 / b.growth_s) * span_s > 1.0:
        return 1.0
    return min(2.0 * a.growth_s / span_s, 1.0)


def _ranked(found: Found, best: Hypothesis) -> tuple[Ranked, ...]:
    """Return the fitted hypotheses of as many effects by posterior probability; larger ones only correct their form."""
    rivals = [h for h in found.hypotheses if h.fit is not None and len(h.entries) <= len(best.entries)]
    odds = np.array([h.odds for h in rivals])
    weights = np.exp(odds - logsumexp(odds))
    order = sorted(range(len(rivals)), key=lambda i: (rivals[i] is not best, -odds[i]))
    return tuple(
        Ranked(fit, -2.0 * float(odds[i]), float(weights[i]), rivals[i].log_bayes)
        for i in order
        if (fit := rivals[i].fit) is not None
    )


def _as_used(found: Fit, part: Part) -> Fit:
    """Return the fit with the values that predict best without known structure, as a simulation has none."""
    used = plainly(part, found)
    same = all(a.size * b.size > 0.0 for a, b in zip(used.entries, found.entries, strict=True))
    return replace(used, total=found.total, chi=found.chi) if same else found
