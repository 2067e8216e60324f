"""Verdict of a finding, with its effects, alternatives, next experiment and network."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.discovery.answer.acceptance import accepted, adequate, effect_on_a_bound, of_form
from twin.discovery.answer.assessed_finding import AssessedFinding
from twin.discovery.answer.blind_spots import further_group_members, practical_ambiguities, structural_ambiguities
from twin.discovery.answer.isolation import (
    alternatives_of,
    grown_by_end,
    isolated_effects,
    nearest_effects,
    of_listed_laws,
)
from twin.discovery.answer.own_course import own_course
from twin.discovery.answer.switches import switched
from twin.discovery.answer.words import summarise
from twin.discovery.diagnosis import Alternative, Diagnosis, Effect, Moved, OwnCourse, Verdict
from twin.discovery.effects.ambiguity_groups import ambiguity_groups
from twin.discovery.effects.open_laws.laws import adopted
from twin.discovery.effects.phrases import clock, said
from twin.discovery.effects.probe import FreeRun
from twin.discovery.evidence.commissioned import nothing, retuned_alone
from twin.discovery.evidence.finding import Finding, Ranked
from twin.discovery.evidence.held_out import contradicted, weights_unreliable
from twin.discovery.evidence.priors import DRIVERS
from twin.discovery.healthy.basis import Basis
from twin.discovery.places.empirical import Empirical, TooMuchHeat, offer
from twin.discovery.places.localise import describe
from twin.discovery.places.sites import drivers_of, signatures, unknown
from twin.discovery.planning.experiment import plan
from twin.discovery.records.grid import Grid, centred
from twin.discovery.refit.fitting import Fit
from twin.discovery.refit.model import Model
from twin.discovery.thermometers.faulty_thermometers import attributed, stuck_effects
from twin.elements.candidates import INTERMITTENT
from twin.network import Array, Network

_TOO_LITTLE = (
    "no effect is likely, and yet the re-tuned twin is off by ten times as much as in health, or by as much as a "
    "constant; check the units of the record's columns, and whether twin and healthy record are of this rig"
)
_FORM = (
    "what no effect explains acts all along, and is less than a fifth of what the twin's own law has at its place: no "
    "more than such a law may be in error itself"
)
_ON_A_BOUND = "the likeliest effect is not claimed, as its size ends on a bound of what is possible"
_REFUTED = "the likeliest effect is not claimed: what it predicts for the held-out segment does not hold there"
_USUAL = (
    "re-tuned, the twin is off on the held-out segment by no more than one as good as when it was commissioned may "
    "be under another load; whether what it left as it was means anything, only a healthy record could tell"
)


@dataclass(frozen=True)
class Answer:
    """Verdict and its parts; `others` are the ambiguity group on this record, `alternatives` were excluded."""

    verdict: Verdict
    effects: tuple[Effect, ...] = ()
    others: tuple[Alternative, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    description: dict[str, Any] = field(default_factory=dict)
    network: Network | None = None
    empirical: Empirical | None = None
    notes: tuple[str, ...] = ()
    own_course: OwnCourse | None = None


def conclude(case: AssessedFinding, notes: tuple[str, ...]) -> Diagnosis:
    """Return the diagnosis of an assessed finding; `notes` are further sentences of its report."""
    finding, known, grid, whole = case.finding, case.known, case.grid, case.whole
    network, start = known.probe.network, float(grid.time[0])
    claimed = finding.fit is not None and accepted(case)
    curve = _one_curve(case) if claimed else None
    if isinstance(curve, TooMuchHeat):
        claimed = False
    elif curve is not None:
        claimed = False
        followed = f"several effects would explain the record together, but all of them follow {curve.variable}"
        notes = (*notes, f"{followed}: one curve of it at {curve.node} does as well")
    ended = effect_on_a_bound(case)
    if ended is not None:
        notes = (*notes, f"{_ON_A_BOUND}: {said(ended.candidate, ended.size)}")
    if not claimed and adequate(case):
        if finding.fit is not None and curve is None:
            notes = (*notes, _REFUTED)
        finding = nothing(finding)
        case = replace(case, finding=finding, errors=retuned_alone(case.errors))
        answer = _with_thermometers(_fine(case), case)
    else:
        answer = _with_thermometers(_named(case) if claimed else _unknown(case), case)
    verdict = answer.verdict
    open_plan = None
    if answer.network is not None:
        open_plan = plan(finding, known, grid, case.limits, verdict == "ambiguous", case.later)
    after = finding.fit or finding.retuned
    readings = _run(finding, after, network, grid)
    return Diagnosis(
        verdict=verdict,
        summary=summarise(verdict, answer.effects, case.errors, answer.others, answer.description, finding),
        effects=answer.effects,
        indistinguishable=answer.others,
        alternatives=answer.alternatives,
        held_out_s=(float(grid.time[case.split]), float(grid.time[-1])),
        errors=case.errors,
        moved=_moved(finding, known),
        blind_spots=(*structural_ambiguities(finding, ambiguity_groups(network)), *practical_ambiguities(finding)),
        ladder=finding.ladder,
        courses=case.free,
        hours=whole.hours + start / 3600.0,
        residual=whole.block_means(grid.measured - _stale(known, grid).readings),
        residual_after=whole.block_means(grid.measured - readings),
        band=whole.noise.sd[0] * math.sqrt(grid.step_s / whole.step_s),
        network=answer.network if verdict == "effect found" else None,
        next_experiment=open_plan,
        warnings=known.warnings,
        notes=(*notes, *answer.notes),
        description=answer.description,
        folds=finding.folds,
        odds=finding.odds,
        claim=finding.claim,
        empirical=answer.empirical,
        own_course=answer.own_course,
    )


def _fine(case: AssessedFinding) -> Answer:
    """Return the answer of a twin that is adequate, with a note if something misfits that is no effect."""
    if case.finding.unlisted >= case.finding.claim and not case.usual and of_form(case):
        return Answer("adequate", notes=(_FORM,))
    loud = case.usual and max(case.finding.odds, case.finding.unlisted) >= case.finding.claim
    return Answer("adequate", notes=(_USUAL,) if loud else ())


def _unknown(case: AssessedFinding) -> Answer:
    """Return the answer of a record that no listed law explains: likeliest place and course, a curve, leads.

    Nothing is said of a place if no odds reach those of a claim, or if the weights of the search are unreliable.
    """
    free, whole, finding = case.free, case.whole, case.finding
    if finding.fit is None and max(finding.odds, finding.unlisted) < finding.claim:
        return Answer("unexplained", alternatives=nearest_effects(finding), notes=(_TOO_LITTLE,))
    # Noise that a healthy record told does not let slow error pass.
    if case.known.plain is None and weights_unreliable(case.errors, case.known.probe.network):
        return Answer("unexplained", alternatives=nearest_effects(case.finding))
    description: dict[str, Any] = {}
    if free:
        drivers = drivers_of(case.known.probe.network, case.grid, whole)
        description = describe(free[0], drivers, whole.step_s / 3600.0) | signatures(free)
    curve = _offered(case) if free else None
    offered = curve if isinstance(curve, Empirical) else None
    return Answer(
        "unexplained",
        effects=unknown(free, description, float(case.grid.time[0])),
        alternatives=nearest_effects(case.finding),
        description=description,
        empirical=offered,
        notes=(*((curve.says,) if isinstance(curve, TooMuchHeat) else ()), *_at_one_moment(case)),
        own_course=None if isinstance(curve, TooMuchHeat) else own_course(case, offered),
    )


def _at_one_moment(case: AssessedFinding) -> tuple[str, ...]:
    """Return a sentence if two effects explain the record and begin at one moment."""
    finding = case.finding
    if finding.together is None:
        return ()
    one, other = (f"{e.candidate.kind} at {e.candidate.where}".replace("_", " ") for e in finding.together)
    moment = clock(float(case.grid.time[0]) + finding.together[0].shape.onset_s)
    both = f"{one} and {other} would explain the record together, but both begin at {moment}: one cause"
    if finding.fit is None:
        return (f"{both} that no law describes is likelier than two",)
    return (f"{both} is likelier than two, and what the one that is told leaves may be an error of its form",)


def _one_curve(case: AssessedFinding) -> Empirical | TooMuchHeat | None:
    """Return the curve of one input at one place that replaces several effects which all follow that input.

    Independent faults rarely follow one input; the held-out segment has to contradict the single cause.
    """
    ranked = case.finding.ranked
    if len(case.finding.entries) < 2 or not ranked:
        return None
    if max((_odds_as_one(r) for r in ranked if _alike(r)), default=-math.inf) < -0.5 * ranked[0].cost:
        return None
    curve = _offered(case)
    if not isinstance(curve, Empirical):
        return curve
    errors = {
        n: replace(e, means=(*e.means[:2], curve.errors[n][1])) for n, e in case.errors.items() if n in curve.errors
    }
    return None if contradicted(errors, case.known.probe.network) else curve


def _alike(ranked: Ranked) -> bool:
    """Return True for effects of different laws that all follow one input: as one cause they are one fault."""
    laws, drivers = {e.candidate.id for e in ranked.entries}, {e.driver for e in ranked.entries}
    return len(laws) == len(ranked.entries) > 1 == len(drivers) and drivers <= DRIVERS.keys()


def _odds_as_one(ranked: Ranked) -> float:
    """Return the log posterior odds of effects with the prior of a single fault."""
    log_prior = -0.5 * ranked.cost - ranked.log_bayes
    return ranked.log_bayes + log_prior / len(ranked.entries)


def _offered(case: AssessedFinding) -> Empirical | TooMuchHeat | None:
    """Return the curve of one variable at one place that replaces an unknown quantity; None if there is none."""
    return offer(case.finding, case.known, case.grid, case.split, case.free, case.errors)


def _named(case: AssessedFinding) -> Answer:
    """Return the answer with named effects, their ambiguity group, and the twin that has them."""
    finding, grid, network = case.finding, case.grid, case.known.probe.network
    assert finding.fit is not None
    verdict, effects = isolated_effects(finding, grid)
    others, alternatives = alternatives_of(finding, verdict)
    others = (*others, *further_group_members(finding, ambiguity_groups(network), others))
    same = {(a.kind, a.where, a.driver) for a in others}
    alternatives = tuple(a for a in alternatives if (a.kind, a.where, a.driver) not in same)
    switches = switched(finding, grid, float(grid.time[0]))
    notes = (*_at_one_moment(case), *(says for _, says in switches))
    passing = any(e.shape.name in INTERMITTENT for e in finding.fit.entries)
    if passing:
        notes += ("an effect that ends, comes back or fades is named and not added to the twin",)
    return Answer(
        verdict,
        effects=of_listed_laws(effects),
        others=of_listed_laws((*others, *(a for a, _ in switches))),
        alternatives=of_listed_laws(alternatives),
        network=None if passing else _bigger(finding, network, grid),
        notes=notes,
    )


def _with_thermometers(answer: Answer, case: AssessedFinding) -> Answer:
    """Return the answer with each effect assigned to one thermometer of several, and with the stuck ones."""
    network, start = case.known.probe.network, float(case.grid.time[0])
    verdict, effects, others = answer.verdict, answer.effects, answer.others
    for group in case.single:
        node = next(s.node for s in network.sensors if s.name == group.sensor)
        before = effects
        effects, same, _ = attributed(effects, group, node, start)
        # What could not be told from the mean's error is no question where one of several errs.
        gone = {e.where for e in before} - {e.where for e in effects}
        others = (*(a for a in others if a.where not in gone), *same)
        verdict = "ambiguous" if same and verdict == "effect found" else verdict
    stood = stuck_effects(case.still)
    verdict = "effect found" if stood and verdict == "adequate" else verdict
    return replace(answer, verdict=verdict, effects=(*stood, *effects), others=others)


def _stale(known: Basis, grid: Grid) -> FreeRun:
    """Return the free run of the commissioned twin."""
    return known.probe.run(grid, known.probe.first_state(grid))


def _run(finding: Finding, fitted: Fit, network: Network, grid: Grid) -> Array:
    """Return the readings (n, m), degC, of a free run with a fit, at the mean times of the samples of bins."""
    model = Model.of(finding.score_test.probe, fitted.entries)
    sizes = np.array([[e.size for e in fitted.entries]])
    state = model.begun(grid.time, grid.inputs, grid.measured, fitted.state, fitted.values, grid.begins)
    (run,) = model.run(grid.time, grid.inputs, state[None], fitted.values[None, :], sizes, begins=grid.begins)
    return centred(run, grid.centre)


def _bigger(finding: Finding, network: Network, grid: Grid) -> Network:
    """Return the twin with its effects at their final sizes, and its re-tuned parameters."""
    assert finding.fit is not None
    named = tuple(e for e in finding.fit.entries if not e.candidate.column)
    model = Model.alone(finding.score_test.probe, named)
    full = np.array([[e.size * grown_by_end(e, grid) for e in named]])
    vector = model.parameters(finding.fit.values[None, :], full)[0]
    own = {p.id for p in model.network.parameters.values() if not p.same_as}
    values = {
        i: float(v)
        for i, v, p in zip(model.network.ids, vector, model.network.parameters.values(), strict=True)
        if i in own and v != p.value
    }
    bigger = model.network.with_values(values)
    for entry in finding.fit.entries:
        if entry.candidate.column:
            bigger = adopted(bigger, entry.candidate, entry.size * grown_by_end(entry, grid))
    return bigger


def _moved(finding: Finding, known: Basis) -> tuple[Moved, ...]:
    """Return each tunable as commissioned, re-tuned and with the effects, and its changes in standard deviations."""
    scaling, q = known.probe.scaling, known.probe.q
    sd = np.sqrt(np.diag(np.linalg.inv(known.prior.precision))[:q])
    network = known.probe.network
    after = finding.fit or finding.retuned
    out = []
    for i, name in enumerate(scaling.ids):
        k = scaling.index[i]
        out.append(
            Moved(
                name,
                float(network.values[k]),
                float(finding.retuned.values[k]),
                float(after.values[k]),
                network.parameters[name].unit,
                float(finding.retuned.moved[i] / sd[i]),
                float(after.moved[i] / sd[i]),
            )
        )
    return tuple(out)
