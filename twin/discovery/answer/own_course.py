"""Claim of an effect whose course follows nothing that was recorded: its kind and place, without a law.

A thermometer that wanders, a heater that drops out at random or a door that somebody opens has a kind and a place, and
no driver. The unknown quantity, free in each block, competes with the sets of named effects by its odds (`evidence/`).
If it beats them, or the held-out segment refutes them, its kind and place are claimed as those of a named effect are:
if no other place is possible, most of the misfit is explained, and no size is beyond what the place can hold. The
effect is not adopted, since nothing predicts its course.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.answer.isolation import of_listed_laws
from twin.discovery.diagnosis import Alternative, Course, Diagnosis, Effect, OwnCourse, Verdict
from twin.discovery.effects.ambiguity_groups import ambiguity_groups
from twin.discovery.effects.statement import disturbance_statement
from twin.discovery.evidence.hypotheses import place, place_of
from twin.discovery.evidence.priors import FORM_ERRORS, FORM_SHARE, SPREAD, SURE
from twin.discovery.places.empirical import Empirical
from twin.discovery.places.localise import courses, describe
from twin.discovery.places.sites import Site, driver_name, drivers_of, heaters_of, sites_of, unknown
from twin.discovery.scoring.equivalence import OPEN
from twin.discovery.scoring.search import Entry

MOST = 0.5
"""Share of the misfit beyond noise that a claimed effect explains at least: most of it."""
BEYOND = 2.0
"""Standard deviations by which a course may lie beyond what its place can hold."""
NOT_PREDICTED, OFFERED = "No law predicts its course, so nothing is adopted", "The curve is offered, not adopted"


def own_course(case: AssessedFinding, curve: Empirical | None) -> OwnCourse | None:
    """Return the claim of an effect with a course of its own; None if the record does not allow one.

    With a `curve` on offer that predicts it, the effect follows the curve's variable.
    """
    finding, whole, network = case.finding, case.whole, case.known.probe.network
    if not case.free or case.known.health is None or finding.unlisted < finding.claim:
        return None
    heaters = heaters_of(network, whole, case.laws)
    found = sorted((*case.free, *courses(whole, heaters, SPREAD)), key=lambda c: -c.log_evidence)
    best, sites = found[0], sites_of(network, whole, case.laws) | heaters
    # The one is of all of the record, the other of the part that the laws were fitted to, and over the same twin.
    if max(best.log_evidence, finding.unlisted) < (1.0 - FORM_SHARE) * finding.odds:
        return None  # laws explain more, though the held-out segment refutes them
    if not _explains(best, case) or not _held(best, sites[best.site]) or _elsewhere(best, finding.together):
        return None
    if any(group.sensor == best.where for group in case.single):
        return None  # which one of several thermometers, only their differences tell
    shares = _shares([replace(c, log_evidence=c.log_evidence / sites[c.site].counts) for c in found])
    left = {label: share for label, share in shares.items() if share > OPEN * shares[best.kind, best.where]}
    if 2 * len(left) > len(shares):
        return None  # most places remain
    effect = _effect(best, case, curve if curve is not None and curve.node == best.site else None)
    effect = replace(effect, confidence=left.pop((best.kind, best.where)))
    others = {label: Alternative(*label, effect.driver, share) for label, share in left.items()}
    alike = ambiguity_groups(network).indistinguishable_from((best.kind, best.where, "constant"))
    others = {label[:2]: Alternative(*label[:2], effect.driver, 0.0) for label in alike} | others
    verdict: Verdict = "effect found" if effect.confidence >= SURE else "ambiguous"
    return OwnCourse(verdict, of_listed_laws((effect,)), of_listed_laws(tuple(others.values())))


def claimed(found: Diagnosis) -> Diagnosis:
    """Return a diagnosis with its effect of an own course claimed, if it has one and no law explains the record."""
    own = found.own_course
    if own is None or found.verdict != "unexplained":
        return found
    beside = tuple(e for e in found.effects if e.kind != "unknown")
    effects = (*beside, *own.effects)
    said = ". ".join(e.says for e in effects)
    places = dict.fromkeys((a.kind, a.where) for a in own.others)
    names = ", ".join(f"{kind.replace('_', ' ')} at {where}" for kind, where in places)
    but = f"; but on this record that is indistinguishable from {names}" if names else ""
    return replace(
        found,
        verdict=own.verdict,
        effects=effects,
        indistinguishable=(*found.indistinguishable, *own.others),
        summary=f"{said}{but}. {NOT_PREDICTED if found.empirical is None else OFFERED}.",
    )


def _shares(found: Sequence[Course]) -> dict[tuple[str, str], float]:
    """Return the posterior probability of each kind and place, of courses with their log evidence.

    A lumped twin distributes an effect among its sensors otherwise than its rig. Another course is therefore as likely
    as the first if its log evidence is smaller by no more than such an error of form may amount to.
    """
    weights: dict[tuple[str, str], float] = {}
    best = max(course.log_evidence for course in found)
    for course in sorted(found, key=lambda c: -c.log_evidence):
        behind = (1.0 - FORM_SHARE) * best - course.log_evidence
        weights.setdefault((course.kind, course.where), math.exp(-max(behind, 0.0)))
    total = sum(weights.values())
    return {label: weight / total for label, weight in weights.items()}


def _effect(course: Course, case: AssessedFinding, curve: Empirical | None) -> Effect:
    """Return a course as an effect, apart from its posterior probability."""
    whole, start = case.whole, float(case.grid.time[0])
    drivers = drivers_of(case.known.probe.network, case.grid, whole)
    description = describe(course, drivers, whole.step_s / 3600.0)
    (effect,) = unknown((course,), description, start)
    since = effect.onset_s if description["onset_s"] else None
    entered = disturbance_statement(effect.where, effect.value, effect.unit, effect.interval90, since, average=True)
    driver = effect.driver if curve is None else driver_name(curve.variable)
    says = f"{entered}, {_course_text(driver) if curve is None else f'on a curve of {curve.variable}'}"
    gone = 100.0 * (1.0 - course.left / whole.misfit)
    evidence = f"{says}; with it {gone:.1f} % of the mismatch is gone"
    return replace(effect, kind=course.kind, driver=driver, shape="own course", says=says, evidence=evidence)


def _elsewhere(course: Course, together: tuple[Entry, Entry] | None) -> bool:
    """Return True if two effects of one moment, which are one cause, are both at other places than a course."""
    return together is not None and place(course.where, course.kind == "sensor") not in {
        place_of(entry.candidate) for entry in together
    }


def _explains(course: Course, case: AssessedFinding) -> bool:
    """Return True if a course explains most of the misfit beyond noise."""
    noise = case.whole.expected * case.whole.count
    beyond = case.whole.misfit - noise
    return beyond > 0.0 and course.left - noise <= (1.0 - MOST) * beyond


def _held(course: Course, site: Site) -> bool:
    """Return True if a place can hold the sizes of a course, within its spread and its form error."""
    low, high = site.holds
    spread = BEYOND * np.hypot(course.sd, max(FORM_ERRORS) * course.mean)
    return bool(np.all(course.mean + spread >= low) and np.all(course.mean - spread <= high))


def _course_text(driver: str) -> str:
    if driver in ("history", "periodic", "threshold", "constant", "elapsed_time"):
        return "on a course of its own that no law describes"
    return f"nearest to the course of {driver.replace('_', ' ')}, but no law of it describes that"
