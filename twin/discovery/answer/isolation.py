"""Fault isolation from a ranked finding: the effects to report, their ambiguity group, and the causes that are
excluded.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TypeVar

import numpy as np

from twin.discovery.answer.words import sentence
from twin.discovery.diagnosis import Alternative, Effect, Verdict
from twin.discovery.effects.ambiguity_groups import EffectLabel
from twin.discovery.effects.phrases import interval
from twin.discovery.evidence.finding import Finding, Ranked
from twin.discovery.evidence.priors import SURE, UNLISTED
from twin.discovery.records.grid import Grid
from twin.discovery.scoring.equivalence import instead, remaining
from twin.discovery.scoring.search import Entry, able_to_begin
from twin.quantiles import NORMAL90

Explained = TypeVar("Explained", Effect, Alternative)


def isolated_effects(finding: Finding, grid: Grid) -> tuple[Verdict, tuple[Effect, ...]]:
    """Return the verdict and each effect of the best fit with its posterior probability.

    The verdict is `effect found` if each has a posterior of at least `SURE`, and also without its prior, else
    `ambiguous`.
    """
    assert finding.fit is not None
    sure = [posterior_share(e, finding.ranked) for e in finding.entries]
    # What is likelier beforehand alone is not named alone: the record itself has to say so.
    distinguished = min(log_bayes_lead(e, finding.ranked) for e in finding.entries) >= math.log(SURE / (1.0 - SURE))
    verdict: Verdict = "effect found" if min(sure) >= SURE and distinguished else "ambiguous"
    return verdict, tuple(_effect(e, finding, s, grid) for e, s in zip(finding.fit.entries, sure, strict=True))


def of_listed_laws(explanations: tuple[Explained, ...]) -> tuple[Explained, ...]:
    """Return effects or alternatives with confidences that leave the share `UNLISTED` for causes of no listed law.

    Shares of the explanations that were compared take it for certain that one of them is true. A cause that no law
    describes may still resemble one closely.
    """
    return tuple(replace(each, confidence=(1.0 - UNLISTED) * each.confidence) for each in explanations)


def posterior_share(entry: Entry, ranked: tuple[Ranked, ...]) -> float:
    """Return the posterior probability of all explanations with the kind and place of an effect."""
    place = (entry.candidate.kind, entry.candidate.where)
    total = sum(r.weight for r in ranked)
    mine = sum(r.weight for r in ranked if any((e.candidate.kind, e.candidate.where) == place for e in r.entries))
    return mine / max(total, 1e-300)


def log_bayes_lead(entry: Entry, ranked: tuple[Ranked, ...]) -> float:
    """Return the log Bayes factor of the best explanation with the kind and place of an effect over the best
    without.
    """
    place = (entry.candidate.kind, entry.candidate.where)
    best = {True: -math.inf, False: -math.inf}
    for r in ranked:
        has = any((e.candidate.kind, e.candidate.where) == place for e in r.entries)
        best[has] = max(best[has], r.log_bayes)
    return best[True] - best[False] if best[False] > -math.inf else math.inf


def alternatives_of(finding: Finding, verdict: Verdict) -> tuple[tuple[Alternative, ...], tuple[Alternative, ...]]:
    """Return the ambiguity group of the answer (with the answer itself if it is ambiguous), and the excluded causes."""
    first = finding.ranked[0]
    left = remaining(finding)[0 if verdict == "ambiguous" else 1 :]
    labels = [instead(r, first).label for r in left]
    same = {label: Alternative(*label, confidence=r.weight) for label, r in zip(labels, left, strict=True)}
    out: dict[tuple[str, str, str], Alternative] = {}
    taken = {e.label for e in first.entries}
    best = max(finding.start - first.fit.total, 0.0) / max(finding.start, 1e-9)
    for r in finding.ranked[1:]:
        label = instead(r, first).label
        if label not in taken and label not in same and label not in out:
            why = f"leaves {r.fit.chi:.2f} of misfit where the answer leaves {first.fit.chi:.2f}"
            if r.fit.chi < first.fit.chi:
                why += ", too little less for what it has to assume"
            if abs(r.fit.chi - first.fit.chi) < 0.02 * first.fit.chi:
                why = f"fits worse by {r.cost - first.cost:.0f} in weighted squares"
            out[label] = Alternative(*label, confidence=r.weight, why_not=why)
    for e in finding.scanned:
        if e.label in taken or e.label in same or e.label in out or len(out) >= 12:
            continue
        share = e.gain / max(finding.start, 1e-9)
        why = f"explains {100.0 * share:.0f} % of the mismatch, the answer {100.0 * best:.0f} %"
        if round(100.0 * share) >= round(100.0 * best):
            why += ", by assuming more: a rarer kind of fault, or a course with more free numbers"
        out[e.label] = Alternative(*e.label, confidence=0.0, why_not=why)
    return tuple(same.values()), tuple(out.values())


def excluded_labels(finding: Finding) -> frozenset[EffectLabel]:
    """Return the labels of hypotheses that were fitted in place of the answer and that this record excludes."""
    first = finding.ranked[0]
    left = {instead(r, first).label for r in remaining(finding)}
    return frozenset(instead(r, first).label for r in finding.ranked[1:]) - left


def nearest_effects(finding: Finding) -> tuple[Alternative, ...]:
    """Return the effects that come nearest to an unexplained record, with the share of the misfit that each
    explains.
    """
    out: dict[tuple[str, str, str], Alternative] = {}
    for e in finding.scanned[:24]:
        if e.label not in out and len(out) < 8:
            share = e.gain / max(finding.start, 1e-9)
            out[e.label] = Alternative(*e.label, 0.0, f"explains {100.0 * share:.0f} % of the mismatch, too little")
    return tuple(out.values())


def _effect(entry: Entry, finding: Finding, sure: float, grid: Grid) -> Effect:
    """Return an entry as a reported effect; `sure` is its confidence. Its size and interval are at the record's end."""
    c, start = entry.candidate, float(grid.time[0])
    spread = NORMAL90 * entry.sd * math.sqrt(max(finding.fit.chi, 1.0)) if finding.fit else 0.0
    early_s, late_s = _onsets(entry, finding)
    grown = grown_by_end(entry, grid)
    spread *= grown
    gain = max(finding.start - (finding.fit.total if finding.fit else 0.0), 0.0)
    share = gain / max(finding.start, 1e-9)
    says = sentence(entry, start, grown, spread)
    return Effect(
        kind=c.kind,
        where=c.where,
        driver=entry.driver,
        change=entry.change,
        value=entry.size * grown,
        unit=c.unit,
        interval90=interval(entry.size * grown, spread, (c.lower, c.upper)),
        onset_s=start + entry.shape.onset_s,
        onset_interval90_s=(start + early_s, start + late_s),
        shape=entry.shape.entered.name,
        confidence=sure,
        z=math.sqrt(gain),
        evidence=f"{says}; with it {100.0 * share:.1f} % of the mismatch is gone",
        growth_s=entry.shape.growth_s,
        level=c.level,
        says=says,
    )


def _onsets(entry: Entry, finding: Finding) -> tuple[float, float]:
    """Return the 90 % interval of an onset, s.

    It holds all onsets that the scan does not distinguish, and half a bin on either side: within a bin, an onset shows
    only as far as the twin is exact there. Slopes about the fit reach no further than the next edge of a block. Where
    the driver of an effect stands still, they give no information about its onset.
    """
    onset, spread = entry.shape.onset_s, NORMAL90 * entry.onset_sd_s
    if onset <= 0.0:
        return 0.0, spread
    assert finding.fit is not None
    score_test = finding.score_test
    others = [e.placed(score_test) for e in finding.fit.entries if e is not entry]
    first, last = able_to_begin(score_test, entry, np.stack(others) if others else np.zeros((0,)))
    if entry.shape.name == "step":
        spread = min(spread, score_test.step_s)
    low, high = min(onset, first), max(onset, last)
    half = 0.5 * score_test.grid.step_s
    early, late = min(low, onset - spread) - half, max(high, onset + spread) + half
    return max(early, 0.0), min(late, score_test.grid.span_s)


def grown_by_end(entry: Entry, grid: Grid) -> float:
    """Return the share of its size that an effect has reached at the end of a record."""
    end = grid.span_s
    return entry.shape.mean(end - 1.0, end) if entry.shape.grows else 1.0
