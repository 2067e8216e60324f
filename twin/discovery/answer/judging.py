"""Judgement of a finding: whether it is told, and whether a twin without one is adequate."""

from __future__ import annotations

from twin.discovery.answer.case import Case
from twin.discovery.evidence.held_out import contradicted


def good(case: Case) -> bool:
    """Return True where effects are claimed and the part that no fit saw does not contradict them."""
    return case.finding.fit is not None and not contradicted(case.errors, case.known.probe.network)


def adequate(case: Case) -> bool:
    """Return True where no effect is claimed and nothing asks for one: the odds of any are too low, or the twin is as
    good as it has always been."""
    finding = case.finding
    return finding.fit is None and (case.usual or max(finding.odds, finding.unlisted) < finding.claim)
