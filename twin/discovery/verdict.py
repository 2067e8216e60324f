"""From fits to a verdict: which causes remain, how sure the first is, whether it is enough, and what to say."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.discovery.contest import Contest
from twin.discovery.diagnosis import Alternative, Course, Diagnosis, Effect, Moved, SensorError, Verdict
from twin.discovery.experiment import propose
from twin.discovery.fitting import Fit
from twin.discovery.grid import Grid, centred
from twin.discovery.localise import courses, describe
from twin.discovery.members import Members, odd_one
from twin.discovery.model import Model
from twin.discovery.probe import Run
from twin.discovery.ranking import Finding, Ranked, enough, piled_up, width
from twin.discovery.readings import Stuck
from twin.discovery.search import Entry
from twin.discovery.validation import holds
from twin.discovery.words import amount, clock, sentence, summarise, when
from twin.network import Array, Network

if TYPE_CHECKING:
    from twin.discovery.engine import Basis

SURE = 0.8
"""Share of the weight that one kind at one place must have to be named alone."""
SE90 = 1.6449


def conclude(
    finding: Finding,
    *,
    network: Network,
    known: Basis,
    whole: Contest,
    grid: Grid,
    split: int,
    errors: dict[str, SensorError],
    notes: tuple[str, ...],
    single: tuple[Members, ...] = (),
    still: tuple[Stuck, ...] = (),
) -> Diagnosis:
    """The verdict with everything that supports it."""
    start = float(grid.time[0])
    scale = finding.count
    left = finding.retuned.chi if finding.fit is None else finding.fit.chi
    good = enough(left, finding.start / scale, finding.contest) and not piled_up(finding.entries)
    good = good and holds(finding.folds)
    verdict: Verdict
    effects: tuple[Effect, ...] = ()
    others: tuple[Alternative, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    description: dict[str, Any] = {}
    bigger: Network | None = None
    found = courses(whole, _sites(known, whole))
    if finding.fit is None and enough(finding.start / scale, 0.0, finding.contest):
        verdict = "adequate"
    elif finding.fit is None or not good:
        verdict = "unexplained"
        if found:
            description = describe(found[0], _drivers(network, grid, whole), whole.step_s / 3600.0)
        effects = _unknown(found, description, start)
        alternatives = _near_misses(finding)
    else:
        sure = _groups(finding.ranked)
        best = (finding.ranked[0].entries[-1].candidate.kind, finding.ranked[0].entries[-1].candidate.where)
        verdict = "effect found" if sure.get(best, 0.0) >= SURE or len(finding.entries) > 1 else "ambiguous"
        effects = tuple(
            _effect(e, finding, sure if i == len(finding.entries) - 1 else {}, start)
            for i, e in enumerate(finding.fit.entries)
        )
        others, alternatives = _others(finding)
        bigger = _bigger(finding, network)
    for one in single:
        verdict, effects = _single(one, network, verdict, effects, finding, start)
    for span in still:
        effects = (_standing(span), *effects)
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
        blind_spots=blind_spots(finding),
        ladder=finding.ladder,
        courses=found,
        hours=whole.hours + start / 3600.0,
        residual=whole.block_means(grid.measured - _stale(known, grid).readings),
        residual_after=whole.block_means(grid.measured - readings),
        band=whole.noise.sd[0] * math.sqrt(grid.step_s / whole.step_s),
        network=bigger,
        next_experiment=_experiment(finding, known, grid) if verdict == "ambiguous" else None,
        warnings=known.warnings,
        notes=notes,
        description=description,
        folds=finding.folds,
        threshold=finding.threshold,
    )


def _single(
    one: Members, network: Network, verdict: Verdict, effects: tuple[Effect, ...], finding: Finding, start: float
) -> tuple[Verdict, tuple[Effect, ...]]:
    """Say which thermometer or place of several it is, where one differs from the others."""
    node = next(s.node for s in network.sensors if s.name == one.sensor)
    here = [i for i, e in enumerate(effects) if e.where in (node, one.sensor)]
    shapes = tuple(e.shape for e in finding.entries) if here and finding.entries else ()
    odd = odd_one(one, shapes) or (odd_one(one) if not here else None)
    if odd is None:
        return verdict, effects
    if here and effects[here[0]].kind not in ("unknown", "sensor"):
        old = effects[here[0]]
        changed = replace(old, where=odd.place, says=f"{old.says}; of several alike, {odd.place} alone")
        return verdict, tuple(changed if i == here[0] else e for i, e in enumerate(effects))
    spread = SE90 * odd.sd
    fault = Effect(
        kind="sensor", where=odd.column, driver="constant" if odd.shape.name == "step" else "elapsed_time",
        change="new", value=odd.size, unit="K", interval90=(odd.size - spread, odd.size + spread),
        onset_s=start + odd.shape.onset_s, onset_interval90_s=(start + odd.shape.onset_s,) * 2, shape=odd.shape.name,
        confidence=odd.share, z=odd.z,
        evidence=f"it carries {100.0 * odd.share:.0f} % of what differs among the thermometers of {one.sensor}",
        says=f"{odd.column} reads {amount(odd.size, 'K')} off {when(odd.shape, start)}",
    )  # fmt: skip
    if here:
        return "effect found", tuple(fault if i == here[0] else e for i, e in enumerate(effects))
    return ("effect found" if verdict == "adequate" else verdict), (*effects, fault)


def _standing(span: Stuck) -> Effect:
    """A thermometer that shows one value and nothing else."""
    says = f"{span.column} stands still at {span.value:.2f} degC from {clock(span.first_s)} to {clock(span.last_s)}"
    return Effect(
        kind="sensor", where=span.column, driver="constant", change="new", value=span.value, unit="degC",
        interval90=(span.value, span.value), onset_s=span.first_s, onset_interval90_s=(span.first_s, span.first_s),
        shape="step", confidence=1.0, z=100.0, evidence="a noisy reading does not repeat itself for so long", says=says,
    )  # fmt: skip


def _experiment(finding: Finding, known: Basis, grid: Grid) -> dict[str, Any]:
    """The experiment that would tell the remaining causes apart, or why there is none."""
    limit = width(max(finding.start - finding.ranked[0].fit.total, 0.0))
    best, labels = [], set()
    for r in finding.ranked:
        e = r.entries[-1]
        if (e.candidate.kind, e.candidate.where) not in labels and r.cost - finding.ranked[0].cost < limit:
            labels.add((e.candidate.kind, e.candidate.where))
            best.append(e)
    if len(best) < 2:
        return {"possible": False, "why": "only one cause is left in the set"}
    found = propose(known.probe, known.book, known.noise, known.prior, grid, tuple(best[:4]))
    if found is None:
        return {
            "possible": False,
            "why": "no sequence of load, pump and fan within the limits separates them: measure one of them by other "
            "means (flow by bucket and stopwatch, power by a second meter, thermometers swapped)",
        }  # fmt: skip
    return {
        "possible": True, "name": found.name, "why": found.why, "expected_difference": found.difference,
        "steps": [{"time_s": t, **values} for t, values in found.steps],
    }  # fmt: skip


def _stale(known: Basis, grid: Grid) -> Run:
    return known.probe.run(grid, known.probe.first_state(grid))


def _run(finding: Finding, fitted: Fit, network: Network, grid: Grid) -> Array:
    model = Model.of(network, fitted.entries, finding.contest.probe.scaling.ids)
    sizes = np.array([[e.size for e in fitted.entries]])
    return centred(model.run(grid.time, grid.inputs, fitted.state[None, :], fitted.values[None, :], sizes)[0])


def _groups(ranked: tuple[Ranked, ...]) -> dict[tuple[str, str], float]:
    """Weight of each kind and place, of the effect added last."""
    out: dict[tuple[str, str], float] = {}
    for r in ranked:
        last = r.entries[-1].candidate
        out[last.kind, last.where] = out.get((last.kind, last.where), 0.0) + r.weight
    return out


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
        family_wise=finding.null.family_wise(math.sqrt(gain)),
        evidence=f"{sentence(entry, start, grown)}; with it {100.0 * share:.1f} % of the mismatch is gone",
        growth_s=entry.shape.growth_s,
        says=sentence(entry, start, grown),
    )


def _others(finding: Finding) -> tuple[tuple[Alternative, ...], tuple[Alternative, ...]]:
    """What cannot be told from the winner, and what was ruled out."""
    first = finding.ranked[0]
    limit = width(max(finding.start - first.fit.total, 0.0))
    same: dict[tuple[str, str, str], Alternative] = {}
    out: dict[tuple[str, str, str], Alternative] = {}
    taken = {e.label for e in first.entries}
    best = max(finding.start - first.fit.total, 0.0) / max(finding.start, 1e-9)
    for r in finding.ranked[1:]:
        last = r.entries[-1]
        label = last.label
        if label in taken or label in same:
            continue
        if r.cost - first.cost < limit and r.weight > 0.003:
            same[label] = Alternative(*label, confidence=r.weight)
        elif label not in out:
            why = f"leaves {r.fit.chi:.2f} of misfit where the answer leaves {first.fit.chi:.2f}"
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


def _sites(known: Basis, contest: Contest) -> dict[str, tuple[Array, float, str]]:
    """Places where an unknown may act, each as a vector of one unit."""
    probe = known.probe
    out: dict[str, tuple[Array, float, str]] = {}
    for k, node in enumerate(probe.network.nodes):
        p = np.zeros((contest.sites, contest.b))
        p[k] = 1.0
        out[node] = (p, 20.0, "W")
    for j, name in enumerate(probe.network.sensor_names):
        p = np.zeros((contest.sites, contest.b))
        p[contest.k + j] = 1.0
        out[name] = (p, 0.2, "K")
    return out


def _drivers(network: Network, grid: Grid, contest: Contest) -> dict[str, Array]:
    names = {"heater_power_W": "heater_power", "pump_speed_pct": "pump_speed", "fan_speed_pct": "fan_speed"}
    out = {}
    means = contest.block_means(grid.inputs)
    for j, column in enumerate(network.input_columns):
        out[names.get(column, "temperature" if column.endswith("_C") else column)] = means[:, j]
    out["elapsed_time"] = contest.hours
    return out


def _unknown(found: tuple[Course, ...], description: dict[str, Any], start: float) -> tuple[Effect, ...]:
    if not found or not description:
        return ()
    best = found[0]
    low, high = description["range"]
    second = found[1].log_evidence if len(found) > 1 else best.log_evidence - 100.0
    return (
        Effect(
            kind="unknown",
            where=best.site,
            driver=str(description["driver"]),
            change="new",
            value=float(description["mean"]),
            unit=best.unit,
            interval90=(float(low), float(high)),
            onset_s=start + float(description["onset_s"]),
            onset_interval90_s=(start + float(description["onset_s"]),) * 2,
            shape="unknown",
            confidence=float(1.0 / (1.0 + math.exp(min(max(second - best.log_evidence, -50.0), 50.0) / 10.0))),
            z=float(np.sqrt(max(best.log_evidence, 0.0) * 2.0)),
            evidence=f"an unknown at {best.site} explains the record better than at any other place",
        ),
    )


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


def blind_spots(finding: Finding) -> tuple[str, ...]:
    """Pairs that this record cannot tell apart although the physics differ."""
    contest = finding.contest
    entries = list({e.candidate.id: e for e in finding.scanned}.values())[:24]
    if len(entries) < 2:
        return ()
    gram, _ = contest.joint(np.stack([e.vector for e in entries]))
    norm = np.sqrt(np.maximum(np.diag(gram), 1e-30))
    rho = gram / np.outer(norm, norm)
    out = []
    for i in range(len(entries)):
        for j in range(i + 1, len(entries)):
            a, b = entries[i], entries[j]
            if abs(rho[i, j]) > 0.999 and a.label != b.label:
                out.append(f"{_name(a)} and {_name(b)} cannot be told apart on this record")
    return tuple(dict.fromkeys(out))[:8]


def _name(e: Entry) -> str:
    return f"{e.candidate.kind.replace('_', ' ')} at {e.candidate.where} ({e.driver.replace('_', ' ')})"
