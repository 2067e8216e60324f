"""Acceptance of a finding: whether its effects are reported, and whether a twin without effects is adequate."""

from __future__ import annotations

import math

from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.evidence.commissioned import explains_too_little
from twin.discovery.evidence.held_out import contradicted


def accepted(case: AssessedFinding) -> bool:
    """Return True if effects are claimed and the held-out segment does not contradict them.

    A held-out segment shorter than a block is a single sample of the unmodelled noise, and contradicts nothing.
    """
    if case.finding.fit is None:
        return False
    held_out_s = (len(case.grid.time) - case.split) * case.grid.step_s
    return held_out_s < case.whole.step_s or not contradicted(case.errors, case.known.probe.network)


def adequate(case: AssessedFinding) -> bool:
    """Return True if no effect is needed: the odds of each are too low, or the error is the usual one of the twin.

    Effects that the held-out segment contradicts are refuted; then either no effect or an unlisted one remains. A twin
    that is off by an order more than in health, or by as much as a constant, is not adequate, whatever noise explains.
    """
    finding = case.finding
    if explains_too_little(case.known.probe.network, case.errors, case.grid.measured):
        return False
    named = finding.odds if finding.fit is None else -math.inf
    return case.usual or case.beyond or max(named, finding.unlisted) < finding.claim
