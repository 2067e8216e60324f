"""From fits to a verdict: which causes remain, how sure the first is, whether it is enough, and what to say."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.discovery.answer.blind_spots import alike_here, always_alike, twins_of
from twin.discovery.answer.spells import as_effect, came_and_went, described, explained, explains, outdone
from twin.discovery.answer.switches import switched
from twin.discovery.answer.words import sentence, summarise
from twin.discovery.diagnosis import Alternative, Diagnosis, Effect, Moved, SensorError, Verdict
from twin.discovery.effects.catalogue import LATE
from twin.discovery.effects.laws import Law
from twin.discovery.effects.lint import lint
from twin.discovery.effects.probe import Run
from twin.discovery.places.empirical import Empirical, offer
from twin.discovery.places.localise import courses, describe
from twin.discovery.places.sites import drivers_of, signatures, sites_of, unknown
from twin.discovery.planning.experiment import Limits, plan
from twin.discovery.records.grid import Grid, centred
from twin.discovery.records.readings import Stuck
from twin.discovery.refit.fitting import Fit
from twin.discovery.refit.model import Model
from twin.discovery.refit.validation import holds
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.equivalence import instead, remaining
from twin.discovery.scoring.search import Entry, able_to_begin
from twin.discovery.selection.held_out import FAR_SHARE, contradicted
from twin.discovery.selection.ladder import EXACT_SHARE
from twin.discovery.selection.ranking import Finding, Ranked, enough, stand
from twin.discovery.thermometers.at_fault import single as single_one
from twin.discovery.thermometers.at_fault import standing
from twin.discovery.thermometers.members import Members
from twin.gauss_newton import SE90
from twin.network import Array, Network

if TYPE_CHECKING:
    from twin.discovery.healthy.basis import Basis

_USUAL = (
    "re-tuned, the twin is as good on the part that no fit saw as when it was commissioned; whether what it left as it "
    "was means anything, only a healthy record could tell"
)
CALM = 1.5
"""Times the threshold that something may score that no fit confirms, and the twin still be adequate."""
REFUTED_SHARE = 0.5
"""Share of the first score from which what is left is of something, though no form of it that was tried foretells."""
REFUTED_LEFT = 0.04
"""Of the squares that re-tuning alone leaves where no fit saw the record, the share up to which an answer may be off by
more than is usual all the same, where there was more of it that no form explains."""
SURE = 0.85
"""Share of the weight that one kind at one place must have to be named alone."""


def conclude(
    finding: Finding,
    *,
    network: Network,
    known: Basis,
    whole: Contest,
    laws: list[Law],
    lasting: list[Entry],
    grid: Grid,
    split: int,
    errors: dict[str, SensorError],
    notes: tuple[str, ...],
    single: tuple[Members, ...] = (),
    still: tuple[Stuck, ...] = (),
    limits: Limits | None = None,
    usual: bool = False,
    doubted: bool = False,
    later: tuple[Grid, ...] = (),
) -> Diagnosis:
    """The verdict with everything that supports it.

    Args:
        usual: what is left of the re-tuned twin is what it has always left, so nothing is missing.
        doubted: an answer to less of the record was contradicted by the rest, so that this one has to leave nothing.
        later: records made since, by which the finding has been weighed.
    """
    start = float(grid.time[0])
    scale = finding.count
    left = finding.retuned.chi if finding.fit is None else finding.fit.chi
    rest = finding.ladder[-1].best_z
    refuted = finding.refuted and rest < REFUTED_SHARE * finding.ladder[0].best_z
    quiet = finding.beside is None and (refuted or finding.formed or rest < finding.threshold)
    quiet = quiet and not doubted
    good = enough(left, 0.0 if doubted else finding.start / scale, finding.contest, quiet=quiet)
    good = good and (finding.fit is None or stand(finding.fit, finding.contest))
    good = good and holds(finding.folds)
    good = good and not contradicted(errors, network, REFUTED_LEFT if finding.refuted else FAR_SHARE)
    good = good and not (doubted and finding.beside is not None and not slight(finding.beside, finding))
    verdict: Verdict
    effects: tuple[Effect, ...] = ()
    others: tuple[Alternative, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    description: dict[str, Any] = {}
    bigger: Network | None = None
    empirical: Empirical | None = None
    groups = lint(network)
    found = courses(whole, sites_of(network, whole, laws))
    # What is late is no multiple of its law, by which its gain would be taken for less.
    told = finding.entries and found and not any(e.candidate.driver in LATE for e in finding.entries)
    if good and told:
        # What cannot be told from the answer is as much of it as what it says first.
        answers = (finding.entries, *(r.entries for r in remaining(finding)[1:]))
        good = not outdone(max(explained(whole, laws, entries) for entries in answers), found[0])
    claimed = finding.fit is not None and good
    calm = finding.ladder[0].best_z < CALM * finding.threshold
    adequate = finding.fit is None and (usual or enough(finding.start / scale, 0.0, finding.contest, quiet=calm))
    late = bool(lasting) and lasting[0].z >= finding.threshold and contradicted(errors, network)
    adequate = adequate and (usual or not late)
    spell = None if adequate else came_and_went(whole, laws, lasting, finding.entries if claimed else ())
    if adequate:
        verdict = "adequate"
        notes = (*notes, *((_USUAL,) if usual and finding.ladder[0].best_z >= finding.threshold else ()))
    elif spell is not None and (claimed or explains(spell, found[0])):
        verdict = "unexplained"
        description, effects = described(spell) | signatures(found), (as_effect(spell, whole, start),)
        alternatives = _near_misses(finding)
        empirical = offer(finding, known, grid, split, found, errors)
    elif finding.fit is None or not good:
        verdict = "unexplained"
        if found:
            description = describe(found[0], drivers_of(network, grid, whole), whole.step_s / 3600.0) | signatures(
                found
            )
            empirical = offer(finding, known, grid, split, found, errors)
        effects = unknown(found, description, start)
        alternatives = _near_misses(finding)
    else:
        sure = _groups(finding.ranked)
        best = (finding.ranked[0].entries[-1].candidate.kind, finding.ranked[0].entries[-1].candidate.where)
        verdict = "effect found" if sure.get(best, 0.0) >= SURE or len(finding.entries) > 1 else "ambiguous"
        effects = tuple(
            _effect(e, finding, sure if i == len(finding.entries) - 1 else _with_and_without(e, finding), grid)
            for i, e in enumerate(finding.fit.entries)
        )
        others, alternatives = _others(finding, verdict)
        others = (*others, *twins_of(finding, groups, others))
        switches = switched(finding, grid, start)
        others, notes = (*others, *(a for a, _ in switches)), (*notes, *(says for _, says in switches))
        bigger = _bigger(finding, network, grid)
        if finding.beside is not None:
            kind, where, driver = (x.replace("_", " ") for x in finding.beside.label)
            notes = (
                *notes,
                f"beside that, {kind} at {where} ({driver}) would still score {finding.beside.z:.1f}: too little next "
                f"to {math.sqrt(max(finding.start - finding.fit.total, 0.0)):.0f} to be told from an effect that is "
                "not quite of the form assumed",
            )
    for one in single:
        before = effects
        verdict, effects, same = single_one(one, network, verdict, effects, finding, start)
        # What could not be told from the mean's error is no question where one of several errs.
        gone = {e.where for e in before} - {e.where for e in effects}
        others = (*(a for a in others if one.sensor not in gone or a.where != one.sensor), *same)
    for span in still:
        effects = (standing(span), *effects)
        verdict = "effect found" if verdict == "adequate" else verdict
    open_plan = None
    if bigger is not None:
        open_plan = plan(finding, known, grid, limits, verdict == "ambiguous", later)
    after = finding.fit or finding.retuned
    readings = _run(finding, after, network, grid)
    return Diagnosis(
        verdict=verdict,
        summary=summarise(verdict, effects, errors, others, description, finding),
        effects=effects,
        indistinguishable=others,
        alternatives=alternatives,
        held_out_s=(float(grid.time[split]), float(grid.time[-1])),
        errors=errors,
        moved=_moved(finding, known),
        blind_spots=(*always_alike(finding, groups), *alike_here(finding)),
        ladder=finding.ladder,
        courses=found,
        hours=whole.hours + start / 3600.0,
        residual=whole.block_means(grid.measured - _stale(known, grid).readings),
        residual_after=whole.block_means(grid.measured - readings),
        band=whole.noise.sd[0] * math.sqrt(grid.step_s / whole.step_s),
        network=bigger if verdict == "effect found" else None,
        next_experiment=open_plan,
        warnings=known.warnings,
        notes=notes,
        description=description,
        folds=finding.folds,
        threshold=finding.threshold,
        empirical=empirical,
    )


def slight(beside: Entry, finding: Finding) -> bool:
    """Whether what scores beside the effects wins too little next to them to be told from an error of form."""
    assert finding.fit is not None
    return beside.gain < EXACT_SHARE * (finding.start - finding.fit.total)


def _stale(known: Basis, grid: Grid) -> Run:
    return known.probe.run(grid, known.probe.first_state(grid))


def _run(finding: Finding, fitted: Fit, network: Network, grid: Grid) -> Array:
    model = Model.of(finding.contest.probe, fitted.entries)
    sizes = np.array([[e.size for e in fitted.entries]])
    state = model.begun(grid.time, grid.inputs, grid.measured, fitted.state, fitted.values, grid.begins)
    return centred(model.run(grid.time, grid.inputs, state[None], fitted.values[None, :], sizes, begins=grid.begins)[0])


def _groups(ranked: tuple[Ranked, ...]) -> dict[tuple[str, str], float]:
    """Share of each kind and place, of the effect added last: of the likeliest thing that it could follow, since to be
    able to follow many things makes a cause no likelier."""
    best: dict[tuple[str, str], float] = {}
    for r in ranked:
        last = r.entries[-1].candidate
        best[last.kind, last.where] = max(best.get((last.kind, last.where), 0.0), r.weight)
    total = sum(best.values())
    return {place: weight / total for place, weight in best.items()}


def _with_and_without(entry: Entry, finding: Finding) -> dict[tuple[str, str], float]:
    """Share of the weight of the likeliest explanation with such a kind at such a place, against one without."""
    place = (entry.candidate.kind, entry.candidate.where)
    best = {True: 0.0, False: 0.0}
    for r in finding.ranked:
        has = any((e.candidate.kind, e.candidate.where) == place for e in r.entries)
        best[has] = max(best[has], r.weight)
    return {place: best[True] / (best[True] + best[False])}


def _effect(entry: Entry, finding: Finding, sure: dict[tuple[str, str], float], grid: Grid) -> Effect:
    c, start = entry.candidate, float(grid.time[0])
    spread = SE90 * entry.sd * math.sqrt(max(finding.fit.chi, 1.0)) if finding.fit else 0.0
    onset_spread = SE90 * entry.onset_sd_s
    first_s, last_s = _onsets(entry, finding)
    grown = _final(entry, grid)
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
        interval90=(entry.size * grown - spread, entry.size * grown + spread),
        onset_s=start + entry.shape.onset_s,
        onset_interval90_s=(
            start + max(min(entry.shape.onset_s - onset_spread, first_s), 0.0),
            start + max(entry.shape.onset_s + onset_spread, last_s),
        ),
        shape=entry.shape.entered.name,
        confidence=sure.get((c.kind, c.where), 1.0),
        z=math.sqrt(gain),
        family_wise=finding.null.family_wise(math.sqrt(gain)),
        evidence=f"{says}; with it {100.0 * share:.1f} % of the mismatch is gone",
        growth_s=entry.shape.growth_s,
        says=says,
    )


def _others(finding: Finding, verdict: Verdict) -> tuple[tuple[Alternative, ...], tuple[Alternative, ...]]:
    """What cannot be told from the winner (of an ambiguous finding with the winner itself), and what was ruled out."""
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
        out[e.label] = Alternative(*e.label, confidence=0.0, why_not=why)
    return tuple(same.values()), tuple(out.values())


def _near_misses(finding: Finding) -> tuple[Alternative, ...]:
    out: dict[tuple[str, str, str], Alternative] = {}
    for e in finding.scanned[:24]:
        if e.label not in out and len(out) < 8:
            share = e.gain / max(finding.start, 1e-9)
            out[e.label] = Alternative(*e.label, 0.0, f"explains {100.0 * share:.0f} % of the mismatch, too little")
    return tuple(out.values())


def _bigger(finding: Finding, network: Network, grid: Grid) -> Network:
    """The twin with its effects at the size that they have at the record's end, and its re-tuned parameters."""
    assert finding.fit is not None
    model = Model.alone(finding.contest.probe, finding.fit.entries)
    full = np.array([[e.size * _final(e, grid) for e in finding.fit.entries]])
    vector = model.parameters(finding.fit.values[None, :], full)[0]
    own = {p.id for p in model.network.parameters.values() if not p.same_as}
    values = {
        i: float(v)
        for i, v, p in zip(model.network.ids, vector, model.network.parameters.values(), strict=True)
        if i in own and v != p.value
    }
    return model.network.with_values(values)


def _onsets(entry: Entry, finding: Finding) -> tuple[float, float]:
    """Between which onsets, s, the scan cannot tell: slopes about a fit see no further than the next edge."""
    if entry.shape.onset_s <= 0.0:
        return 0.0, 0.0
    assert finding.fit is not None
    others = [e.placed(finding.contest) for e in finding.fit.entries if e is not entry]
    return able_to_begin(finding.contest, entry, np.stack(others) if others else np.zeros((0,)))


def _final(entry: Entry, grid: Grid) -> float:
    end = grid.span_s
    return entry.shape.mean(end - 1.0, end) if entry.shape.grows else 1.0


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
