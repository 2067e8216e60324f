"""From a finding to a verdict, with everything that supports it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.discovery.answer.blind_spots import alike_here, always_alike, twins_of
from twin.discovery.answer.case import Case
from twin.discovery.answer.judging import adequate, good
from twin.discovery.answer.spells import Spell, as_effect, came_and_went, described, explains
from twin.discovery.answer.switches import switched
from twin.discovery.answer.telling import grown_by_end, likelier_in_all, near_misses, rivals, told, told_by_evidence
from twin.discovery.answer.words import summarise
from twin.discovery.diagnosis import Alternative, Diagnosis, Effect, Moved, Verdict
from twin.discovery.effects.lint import lint
from twin.discovery.effects.open_laws import adopted
from twin.discovery.effects.phrases import clock
from twin.discovery.effects.probe import Run
from twin.discovery.effects.shapes import TIMED
from twin.discovery.healthy.basis import Basis
from twin.discovery.places.empirical import Empirical, offer
from twin.discovery.places.localise import describe
from twin.discovery.places.sites import drivers_of, signatures, unknown
from twin.discovery.planning.experiment import plan
from twin.discovery.records.grid import Grid, centred
from twin.discovery.refit.fitting import Fit
from twin.discovery.refit.model import Model
from twin.discovery.selection.caution import nothing, retuned_alone
from twin.discovery.selection.held_out import misled
from twin.discovery.selection.ranking import Finding
from twin.discovery.thermometers.at_fault import single, standing
from twin.discovery.thermometers.members import apart
from twin.network import Array, Network

_USUAL = (
    "re-tuned, the twin is off on the part that no fit saw by no more than one as good as when it was commissioned may "
    "be under another load; whether what it left as it was means anything, only a healthy record could tell"
)


@dataclass(frozen=True)
class Answer:
    """A verdict and what belongs to it; `others` cannot be told from it here, `alternatives` were ruled out."""

    verdict: Verdict
    effects: tuple[Effect, ...] = ()
    others: tuple[Alternative, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    description: dict[str, Any] = field(default_factory=dict)
    network: Network | None = None
    empirical: Empirical | None = None
    notes: tuple[str, ...] = ()


def conclude(case: Case, notes: tuple[str, ...]) -> Diagnosis:
    """The verdict with everything that supports it; `notes` are what is to be said beside it."""
    finding, known, grid, whole = case.finding, case.known, case.grid, case.whole
    network, start = known.probe.network, float(grid.time[0])
    claimed = finding.fit is not None and good(case)
    if not claimed and adequate(case):
        finding = nothing(finding)
        case = replace(case, finding=finding, errors=retuned_alone(case.errors))
        answer = _with_thermometers(_fine(case), case)
    else:
        answer = _with_thermometers(_answer(case, claimed), case)
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
        blind_spots=(*always_alike(finding, lint(network)), *alike_here(finding)),
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
        threshold=finding.threshold,
        empirical=answer.empirical,
    )


def _fine(case: Case) -> Answer:
    loud = case.usual and case.finding.ladder[0].best_z >= case.finding.threshold
    return Answer("adequate", notes=(_USUAL,) if loud else ())


def _answer(case: Case, claimed: bool) -> Answer:
    finding, free = case.finding, case.free
    if case.by_evidence:
        return _named(case) if claimed else _unknown(case)
    spell = came_and_went(case.whole, case.laws, case.lasting, finding.entries if claimed else ())
    if spell is not None and (claimed or explains(spell, free[0])):
        return _for_a_spell(case, spell)
    return _named(case) if claimed else _unknown(case)


def _for_a_spell(case: Case, spell: Spell) -> Answer:
    return Answer(
        "unexplained",
        effects=(as_effect(spell, case.whole, float(case.grid.time[0])),),
        alternatives=near_misses(case.finding),
        description=described(spell) | signatures(case.free),
        empirical=_offered(case),
    )


def _unknown(case: Case) -> Answer:
    free, whole = case.free, case.whole
    # Noise that a healthy record told does not let slow error pass.
    if case.known.plain is None and misled(case.errors, case.known.probe.network):
        return Answer("unexplained", alternatives=near_misses(case.finding))
    description: dict[str, Any] = {}
    if free:
        drivers = drivers_of(case.known.probe.network, case.grid, whole)
        description = describe(free[0], drivers, whole.step_s / 3600.0) | signatures(free)
    return Answer(
        "unexplained",
        effects=unknown(free, description, float(case.grid.time[0])),
        alternatives=near_misses(case.finding),
        description=description,
        empirical=_offered(case) if free else None,
        notes=_at_one_moment(case),
    )


def _at_one_moment(case: Case) -> tuple[str, ...]:
    """Return what is to say of two effects that would explain the record and begin at one moment."""
    if case.finding.together is None:
        return ()
    one, other = (f"{e.candidate.kind} at {e.candidate.where}".replace("_", " ") for e in case.finding.together)
    moment = clock(float(case.grid.time[0]) + case.finding.together[0].shape.onset_s)
    return (
        f"{one} and {other} would explain the record together, but both begin at {moment}: one cause that no law "
        "describes is likelier than two",
    )


def _offered(case: Case) -> Empirical | None:
    return offer(case.finding, case.known, case.grid, case.split, case.free, case.errors)


def _named(case: Case) -> Answer:
    finding, grid, network = case.finding, case.grid, case.known.probe.network
    assert finding.fit is not None
    verdict, effects = told_by_evidence(finding, grid) if case.by_evidence else told(finding, grid)
    likelier = () if case.by_evidence else likelier_in_all(case)
    if likelier:
        verdict = "ambiguous"
    others, alternatives = rivals(finding, verdict)
    others = (*others, *twins_of(finding, lint(network), others))
    known = {(a.kind, a.where) for a in others}
    likelier = tuple(a for a in likelier if (a.kind, a.where) not in known)
    others = (*others, *likelier)
    alternatives = tuple(a for a in alternatives if (a.kind, a.where) not in {(b.kind, b.where) for b in likelier})
    switches = switched(finding, grid, float(grid.time[0]))
    notes = tuple(says for _, says in switches)
    passing = any(e.shape.name in TIMED for e in finding.fit.entries)
    if passing:
        notes += ("an effect that ends, comes back or fades is named and not added to the twin",)
    if finding.beside is not None:
        kind, where, driver = (x.replace("_", " ") for x in finding.beside.label)
        notes += (
            f"beside that, {kind} at {where} ({driver}) would still score {finding.beside.z:.1f}: too little next "
            f"to {math.sqrt(max(finding.start - finding.fit.total, 0.0)):.0f} to be told from an effect that is "
            "not quite of the form assumed",
        )
    return Answer(
        verdict,
        effects=effects,
        others=(*others, *(a for a, _ in switches)),
        alternatives=alternatives,
        network=None if passing else _bigger(finding, network, grid),
        notes=notes,
    )


def _with_thermometers(answer: Answer, case: Case) -> Answer:
    """The answer, where one thermometer of several differs or one stands still, with which, and what is the matter."""
    network, start = case.known.probe.network, float(case.grid.time[0])
    verdict, effects, others = answer.verdict, answer.effects, answer.others
    for one in (each for group in case.single for each in apart(group)):
        before = effects
        verdict, effects, same = single(one, network, verdict, effects, case.finding, start)
        # What could not be told from the mean's error is no question where one of several errs.
        gone = {e.where for e in before} - {e.where for e in effects}
        others = (*(a for a in others if one.sensor not in gone or a.where != one.sensor), *same)
    for column in dict.fromkeys(span.column for span in reversed(case.still)):
        effects = (standing(tuple(span for span in case.still if span.column == column)), *effects)
        verdict = "effect found" if verdict == "adequate" else verdict
    return replace(answer, verdict=verdict, effects=effects, others=others)


def _stale(known: Basis, grid: Grid) -> Run:
    return known.probe.run(grid, known.probe.first_state(grid))


def _run(finding: Finding, fitted: Fit, network: Network, grid: Grid) -> Array:
    model = Model.of(finding.contest.probe, fitted.entries)
    sizes = np.array([[e.size for e in fitted.entries]])
    state = model.begun(grid.time, grid.inputs, grid.measured, fitted.state, fitted.values, grid.begins)
    return centred(model.run(grid.time, grid.inputs, state[None], fitted.values[None, :], sizes, begins=grid.begins)[0])


def _bigger(finding: Finding, network: Network, grid: Grid) -> Network:
    """The twin with its effects at the size that they have at the record's end, and its re-tuned parameters."""
    assert finding.fit is not None
    named = tuple(e for e in finding.fit.entries if not e.candidate.column)
    model = Model.alone(finding.contest.probe, named)
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
    scaling, q = known.probe.scaling, known.probe.q
    sd = np.sqrt(np.diag(np.linalg.inv(known.prior.precision))[:q])
    network = known.probe.network
    after = finding.fit or finding.retuned
    out = []
    for i, name in enumerate(scaling.ids):
        k = scaling.index[i]
        out.append(
            Moved(
                name, float(network.values[k]), float(finding.retuned.values[k]), float(after.values[k]),
                network.parameters[name].unit, float(finding.retuned.moved[i] / sd[i]), float(after.moved[i] / sd[i]),
            )
        )  # fmt: skip
    return tuple(out)
