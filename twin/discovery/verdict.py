"""From fits to a verdict: which causes remain, how sure the first is, whether it is enough, and what to say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.discovery.blind_spots import alike_here, always_alike, twins_of
from twin.discovery.contest import Contest
from twin.discovery.diagnosis import Alternative, Diagnosis, Effect, Moved, Rung, SensorError, Verdict
from twin.discovery.empirical import Empirical, offer
from twin.discovery.equivalence import remaining, width
from twin.discovery.experiment import Limits, plan
from twin.discovery.fitting import Fit
from twin.discovery.grid import Grid, centred
from twin.discovery.laws import Law
from twin.discovery.lint import lint
from twin.discovery.localise import courses, describe
from twin.discovery.members import Members
from twin.discovery.model import Model
from twin.discovery.probe import Run
from twin.discovery.readings import Stuck
from twin.discovery.search import Entry
from twin.discovery.sites import drivers_of, signatures, sites_of, unknown
from twin.discovery.thermometers import SE90, standing
from twin.discovery.thermometers import single as single_one
from twin.discovery.words import sentence, summarise
from twin.network import Array, Network

if TYPE_CHECKING:
    from twin.discovery.engine import Basis

SURE = 0.8
"""Share of the weight that one kind at one place must have to be named alone."""
LEFT = 1.3
"""Misfit that a twin with the right effects may leave, over what noise alone leaves."""
LEFT_SHARE = 0.03
"""Or this share of the misfit that it began with: no effect is of quite the form assumed."""
_TYPICALS = 20.0
_PRIOR = {
    "heat_source": 1.0, "heat_loss": 1.0, "heat_rejection": 1.0, "flow": 0.7, "thermal_mass": 0.7, "sensor": 0.7,
    "coupling": 0.4, "delay": 0.5, "actuator": 0.3,
}  # fmt: skip
_MOVED_BY = {"pump_speed": "loop", "fan_speed": "radiator", "heater_power": "heater"}
"""What an actuator moves: a pump that turns slower is a flow that is less."""
_RARE = {"temperature": 0.6, "fan_speed": 0.5, "pump_speed": 0.5, "heater_power": 0.5, "time_of_day": 0.3}


def enough(chi: float, start: float, contest: Contest) -> bool:
    """Whether a misfit per block and sensor is as small as can be asked, for a twin that began with `start`."""
    return chi <= max(LEFT * contest.expected, LEFT_SHARE * start)


def piled_up(entries: tuple[Entry, ...]) -> bool:
    """Whether effects share a place: they then stand for one of a form that no candidate has."""
    named = [e.candidate.where.removeprefix("T_").removesuffix("_C") for e in entries]
    places = [_MOVED_BY.get(name, name) for name in named]
    same = [tuple(e.candidate.changes) for e in entries]
    return len(set(places)) < len(places) or len(set(same)) < len(same)


@dataclass(frozen=True)
class Ranked:
    """A set of effects, fitted: `cost` is -2 log likelihood and complexity up to a constant, `weight` its share."""

    fit: Fit
    cost: float
    weight: float

    @property
    def entries(self) -> tuple[Entry, ...]:
        return self.fit.entries


@dataclass(frozen=True)
class Finding:
    """What the search ended with; `fit` is None where nothing passed the threshold."""

    entries: tuple[Entry, ...]
    fit: Fit | None
    retuned: Fit
    ranked: tuple[Ranked, ...]
    scanned: tuple[Entry, ...]
    start: float
    count: int
    ladder: tuple[Rung, ...]
    contest: Contest
    state: Array


def rank(trials: list[tuple[Fit, tuple[Entry, ...]]], contest: Contest, start: float) -> tuple[Ranked, ...]:
    """Fits by cost; weights are tempered by `width`. `start` is the misfit without any effect.

    What is plausible beforehand counts once, in the weights, and never in the cost: the cost says what data tell.
    """
    costs = []
    for fitted, _ in trials:
        cost = fitted.total
        for e in fitted.entries:
            free = 1.0 + (e.shape.onset_s > 0.0) + (e.shape.name != "step")
            cost += free * math.log(contest.count)
            cost += min((e.size / (_TYPICALS * e.candidate.typical)) ** 2, 20.0)
        costs.append(cost)
    limit = width(max(start - min(f.total for f, _ in trials), 0.0))
    for i, (fitted, _) in enumerate(trials):
        if any(costs[k] < costs[i] + limit for k in _without_growth(fitted.entries, trials)):
            # What is as well explained by something that is simply there has no need to grow.
            costs[i] += limit
    least = min(costs)
    temper = limit / 10.0
    raw = [math.exp(-0.5 * (c - least) / temper) * _prior(f.entries) for c, (f, _) in zip(costs, trials, strict=True)]
    total = sum(raw)
    order = sorted(range(len(costs)), key=lambda i: -raw[i])
    return tuple(Ranked(trials[i][0], costs[i], raw[i] / total) for i in order)


def _without_growth(entries: tuple[Entry, ...], trials: list[tuple[Fit, tuple[Entry, ...]]]) -> list[int]:
    """Trials with the same candidates, the last of which comes in at once where here it grows."""
    last = entries[-1]
    if last.shape.name == "step":
        return []
    return [
        k
        for k, (other, _) in enumerate(trials)
        if other.entries[-1].shape.name == "step"
        and other.entries[-1].candidate.id == last.candidate.id
        and len(other.entries) == len(entries)
    ]


def _prior(entries: tuple[Entry, ...]) -> float:
    return math.prod(plausibility(e) for e in entries)


def plausibility(entry: Entry) -> float:
    """How likely such an effect is before any data, relative to a constant heat source."""
    value = _PRIOR.get(entry.candidate.kind, 0.5) * _RARE.get(entry.candidate.driver, 1.0)
    if entry.shape.name != "step" and entry.candidate.kind == "actuator":
        value *= 0.2
    return value * (0.5 if entry.shape.name == "saturating" else 1.0)


def conclude(
    finding: Finding,
    *,
    network: Network,
    known: Basis,
    whole: Contest,
    laws: list[Law],
    grid: Grid,
    split: int,
    errors: dict[str, SensorError],
    notes: tuple[str, ...],
    single: tuple[Members, ...] = (),
    still: tuple[Stuck, ...] = (),
    limits: Limits | None = None,
) -> Diagnosis:
    """The verdict with everything that supports it."""
    start = float(grid.time[0])
    scale = finding.count
    left = finding.retuned.chi if finding.fit is None else finding.fit.chi
    good = enough(left, finding.start / scale, finding.contest) and not piled_up(finding.entries)
    verdict: Verdict
    effects: tuple[Effect, ...] = ()
    others: tuple[Alternative, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    description: dict[str, Any] = {}
    bigger: Network | None = None
    empirical: Empirical | None = None
    groups = lint(network)
    found = courses(whole, sites_of(network, whole, laws))
    # What the twin's structure seems to be in the healthy record too is no reason to call it wrong now.
    structural = max((e.bare_gain for e in finding.scanned), default=0.0)
    quiet = enough(finding.start / scale, 0.0, finding.contest)
    if finding.fit is None and enough((finding.start - structural) / scale, 0.0, finding.contest):
        verdict = "adequate"
        if not quiet:
            notes = (
                *notes,
                f"the twin leaves {finding.start / scale:.2f} of misfit where noise alone leaves "
                f"{finding.contest.expected:.2f}, as its own structure may; a small effect could hide behind that",
            )
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
            _effect(e, finding, sure if i == len(finding.entries) - 1 else {}, start)
            for i, e in enumerate(finding.fit.entries)
        )
        others, alternatives = _others(finding, verdict)
        others = (*others, *twins_of(finding, groups, others))
        bigger = _bigger(finding, network)
    for one in single:
        verdict, effects = single_one(one, network, verdict, effects, finding, start)
    for span in still:
        effects = (standing(span), *effects)
        verdict = "effect found" if verdict == "adequate" else verdict
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
        band=known.noise.sd[0] * math.sqrt(grid.step_s / whole.step_s),
        network=bigger if verdict == "effect found" else None,
        next_experiment=plan(finding, known, grid, limits, verdict == "ambiguous") if bigger is not None else None,
        warnings=known.warnings,
        notes=notes,
        description=description,
        empirical=empirical,
    )


def _stale(known: Basis, grid: Grid) -> Run:
    return known.probe.run(grid, known.probe.first_state(grid))


def _run(finding: Finding, fitted: Fit, network: Network, grid: Grid) -> Array:
    model = Model.of(network, fitted.entries, finding.contest.probe.scaling.ids)
    sizes = np.array([[e.size for e in fitted.entries]])
    return centred(model.run(grid.time, grid.inputs, fitted.state[None, :], fitted.values[None, :], sizes)[0])


def _groups(ranked: tuple[Ranked, ...]) -> dict[tuple[str, str], float]:
    """Share of each kind and place, of the effect added last: of the likeliest thing that it could follow, since to be
    able to follow many things makes a cause no likelier."""
    best: dict[tuple[str, str], float] = {}
    for r in ranked:
        last = r.entries[-1].candidate
        best[last.kind, last.where] = max(best.get((last.kind, last.where), 0.0), r.weight)
    total = sum(best.values())
    return {place: weight / total for place, weight in best.items()}


def _effect(entry: Entry, finding: Finding, sure: dict[tuple[str, str], float], start: float) -> Effect:
    c = entry.candidate
    spread = SE90 * entry.sd * math.sqrt(max(finding.fit.chi, 1.0)) if finding.fit else 0.0
    onset_spread = SE90 * entry.onset_sd_s
    grown = _final(entry, finding)
    spread *= grown
    gain = max(finding.start - (finding.fit.total if finding.fit else 0.0), 0.0)
    share = gain / max(finding.start, 1e-9)
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
            start + max(entry.shape.onset_s - onset_spread, 0.0),
            start + entry.shape.onset_s + onset_spread,
        ),
        shape=entry.shape.name,
        confidence=sure.get((c.kind, c.where), 1.0),
        z=math.sqrt(gain),
        evidence=f"{sentence(entry, start, grown)}; with it {100.0 * share:.1f} % of the mismatch is gone",
        growth_s=entry.shape.growth_s,
        says=sentence(entry, start, grown),
    )


def _others(finding: Finding, verdict: Verdict) -> tuple[tuple[Alternative, ...], tuple[Alternative, ...]]:
    """What cannot be told from the winner (of an ambiguous finding with the winner itself), and what was ruled out."""
    first = finding.ranked[0]
    left = remaining(finding)[0 if verdict == "ambiguous" else 1 :]
    same = {r.entries[-1].label: Alternative(*r.entries[-1].label, confidence=r.weight) for r in left}
    out: dict[tuple[str, str, str], Alternative] = {}
    taken = {e.label for e in first.entries}
    best = max(finding.start - first.fit.total, 0.0) / max(finding.start, 1e-9)
    for r in finding.ranked[1:]:
        label = r.entries[-1].label
        if label not in taken and label not in same and label not in out:
            why = f"leaves {r.fit.chi:.2f} of misfit where the answer leaves {first.fit.chi:.2f}"
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


def _bigger(finding: Finding, network: Network) -> Network:
    """The twin with its effects at full size and its re-tuned parameters."""
    assert finding.fit is not None
    model = Model.of(network, finding.fit.entries, finding.contest.probe.scaling.ids)
    full = np.array([[e.size * _final(e, finding) for e in finding.fit.entries]])
    vector = model.parameters(finding.fit.values[None, :], full)[0]
    own = {p.id for p in model.network.parameters.values() if not p.same_as}
    values = {
        i: float(v)
        for i, v, p in zip(model.network.ids, vector, model.network.parameters.values(), strict=True)
        if i in own and v != p.value
    }
    return model.network.with_values(values)


def _final(entry: Entry, finding: Finding) -> float:
    end = finding.contest.grid.span_s
    return 1.0 if entry.shape.name == "step" else entry.shape.mean(end - 1.0, end)


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
