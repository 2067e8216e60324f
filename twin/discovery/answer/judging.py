"""Whether a finding is good enough to be told, and whether a twin without one is good enough as it is."""

from __future__ import annotations

import math

import numpy as np

from twin.discovery.answer.case import Case
from twin.discovery.answer.spells import explained, outdone
from twin.discovery.effects.catalogue import LATE
from twin.discovery.evidence.priors import CLAIM
from twin.discovery.refit.validation import holds
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.equivalence import remaining
from twin.discovery.scoring.search import Entry
from twin.discovery.selection.held_out import FAR_SHARE, contradicted
from twin.discovery.selection.ladder import EXACT_SHARE
from twin.discovery.selection.ranking import Finding, enough, stand

CALM = 1.5
"""Times the threshold that something may score that no fit confirms, and the twin still be adequate."""
REFUTED_SHARE = 0.5
"""Share of the first score from which what is left is of something, though no form of it that was tried foretells."""
REFUTED_LEFT = 0.04
"""Of the squares that re-tuning alone leaves where no fit saw the record, the share up to which an answer may be off by
more than is usual all the same, where there was more of it that no form explains."""

A_DAY_ACTS_S, ACTS = 7200.0, 0.1
"""Least time that what follows the time of day acts, with this share of its most: cut off by its onset and by the
evening, it is anything that lasts for minutes."""


def good(case: Case) -> bool:
    """Whether effects leave no more than they may: of the squares, in each fold, and where no fit saw the record."""
    finding, network = case.finding, case.known.probe.network
    if case.by_evidence:
        return finding.fit is not None and not contradicted(case.errors, network)
    rest = finding.ladder[-1].best_z
    refuted = finding.refuted and rest < REFUTED_SHARE * finding.ladder[0].best_z
    quiet = finding.beside is None and (refuted or finding.formed or rest < finding.threshold)
    left = finding.retuned.chi if finding.fit is None else finding.fit.chi
    before = 0.0 if case.doubted else finding.start / finding.count
    return (
        enough(left, before, finding.contest, quiet=quiet and not case.doubted)
        and (finding.fit is None or stand(finding.fit, finding.contest))
        and holds(finding.folds)
        and not contradicted(case.errors, network, REFUTED_LEFT if finding.refuted else FAR_SHARE)
        and not (case.doubted and finding.beside is not None and not slight(finding.beside, finding))
        and not _outdone(case)
        and all(
            acts_s(e, finding.contest) >= A_DAY_ACTS_S for e in finding.entries if e.candidate.driver == "time_of_day"
        )
    )


def acts_s(entry: Entry, contest: Contest) -> float:
    """How long an effect acts in a record, s."""
    much = np.abs(entry.placed(contest)).max(axis=0)
    return float((much > ACTS * much.max()).sum()) * contest.step_s


def adequate(case: Case) -> bool:
    """Whether the twin needs nothing, where no effect is claimed: what it leaves is noise or what it always leaves."""
    finding, lasting = case.finding, case.lasting
    if case.by_evidence:
        # What the part that no fit saw contradicts is refuted; nothing remains, or an effect of no listed form.
        named = finding.odds if finding.fit is None else -math.inf
        return case.usual or max(named, finding.unlisted) < CLAIM
    silent = bool(case.free) and case.free[0].log_evidence <= 0.0
    if finding.fit is not None and not silent:
        return False
    if case.usual:
        return True
    calm = finding.ladder[0].best_z < CALM * finding.threshold
    late = bool(lasting) and lasting[0].z >= finding.threshold
    late = late and contradicted(case.errors, case.known.probe.network) and not silent
    return enough(finding.start / finding.count, 0.0, finding.contest, quiet=calm) and not late


def slight(beside: Entry, finding: Finding) -> bool:
    """Whether what scores beside the effects wins too little next to them to be told from an error of form."""
    assert finding.fit is not None
    return beside.gain < EXACT_SHARE * (finding.start - finding.fit.total)


def _outdone(case: Case) -> bool:
    """Whether an unknown free to change says more than every answer that cannot be told from the first."""
    finding = case.finding
    # What is late is no multiple of its law, by which its gain would be taken for less.
    if not finding.entries or not case.free or any(e.candidate.driver in LATE for e in finding.entries):
        return False
    answers = (finding.entries, *(r.entries for r in remaining(finding)[1:]))
    return outdone(max(explained(case.whole, case.laws, entries) for entries in answers), case.free[0])
