"""Acceptance of a finding: whether its effects are reported, and whether a twin without effects is adequate."""

from __future__ import annotations

import math

import numpy as np

from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.evidence.commissioned import explains_too_little
from twin.discovery.evidence.held_out import contradicted
from twin.discovery.evidence.priors import FORM_LIMIT
from twin.discovery.places.localise import acts_all_along
from twin.discovery.places.sites import sites_of
from twin.discovery.scoring.search import Entry


def accepted(case: AssessedFinding) -> bool:
    """Return True if effects are claimed, of possible sizes, and the held-out segment does not contradict them.

    A held-out segment shorter than a block is a single sample of the unmodelled noise, and contradicts nothing.
    """
    if case.finding.fit is None or effect_on_a_bound(case) is not None:
        return False
    held_out_s = (len(case.grid.time) - case.split) * case.grid.step_s
    if held_out_s < case.whole.step_s:
        return True
    return not contradicted(case.errors, case.known.probe.network)


def effect_on_a_bound(case: AssessedFinding) -> Entry | None:
    """Return an effect of the answer that ends on a bound of what its place can have; None if there is none."""
    return next((e for e in case.finding.entries if e.on_bound), None)


def adequate(case: AssessedFinding) -> bool:
    """Return True if no effect is needed: the odds of each are too low, or the error is the usual one of the twin.

    Effects that the held-out segment contradicts are refuted; then either no effect or an unlisted one remains. A twin
    that is off by an order more than in health, or by as much as a constant, is not adequate, whatever noise explains.
    """
    finding = case.finding
    if explains_too_little(case.known.probe.network, case.errors, case.grid.measured):
        return False
    if effect_on_a_bound(case) is not None:
        return False
    named = finding.odds if finding.fit is None else -math.inf
    if finding.unlisted >= named and of_form(case):
        return True
    return case.usual or max(named, finding.unlisted) < finding.claim


def of_form(case: AssessedFinding) -> bool:
    """Return True if the likeliest unknown is no more than the form error of one of the twin's own laws.

    The law of an element is not quite right, as that of an effect is not. Such an error acts all along, and is at most
    the share `FORM_LIMIT` of what the element has.
    """
    if not case.free:
        return False
    best = case.free[0]
    site = sites_of(case.known.probe.network, case.whole, case.laws)[best.site]
    size = float(np.sqrt(np.mean(best.mean**2)))
    return size <= FORM_LIMIT * site.present and acts_all_along(best)
