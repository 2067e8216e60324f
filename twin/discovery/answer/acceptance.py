"""Judgement of a finding: whether it is told, and whether a twin without one is adequate."""

from __future__ import annotations

import math

from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.evidence.held_out import contradicted


def accepted(case: AssessedFinding) -> bool:
    """Return True where effects are claimed and the held-out segment does not contradict them.

    A segment shorter than a block is a single sample of what no fit resolves, and contradicts nothing.
    """
    if case.finding.fit is None:
        return False
    held_out_s = (len(case.grid.time) - case.split) * case.grid.step_s
    return held_out_s < case.whole.step_s or not contradicted(case.errors, case.known.probe.network)


def adequate(case: AssessedFinding) -> bool:
    """Return True where nothing asks for an effect: the odds of any are too low, or the twin is as good as always.

    Effects that the held-out segment contradicts are refuted; what remains is nothing, or an unlisted effect.
    """
    finding = case.finding
    named = finding.odds if finding.fit is None else -math.inf
    return case.usual or case.beyond or max(named, finding.unlisted) < finding.claim
