"""Isolation of faulty thermometers: stuck ones, and one of several that deviates from the others.

A deviating one of several is examined first. Its error is subtracted from the mean of all, and the record is then
diagnosed without it. Heat that is found at their common place belongs to one of their places, if one thermometer shows
it more than the others; the rest of that thermometer's deviation is its own fault.
"""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.diagnosis import Alternative, Diagnosis, Effect, Verdict
from twin.discovery.effects.phrases import amount, clock, when
from twin.discovery.effects.shapes import Shape
from twin.discovery.healthy.basis import Columns
from twin.discovery.records.stuck_readings import Stuck
from twin.discovery.thermometers.deviations import (
    Deviation,
    apart,
    deviating_member,
    intermittent_member,
    lagging_member,
    onset_interval,
)
from twin.discovery.thermometers.fault_hypotheses import FaultHypothesis, fault_hypotheses, has_thermal_onset
from twin.discovery.thermometers.members import LATE_WINDOW_S, Members
from twin.network import Array, Network
from twin.quantiles import NORMAL90

HEATS = ("heat_source", "heat_loss")
"""Kinds that warm or cool one place of several, whose thermometer then deviates without a fault."""
SURE, OPEN = 0.85, 0.05
"""Probability from which a hypothesis is reported alone, and share of the likeliest one's above which it stays in the
ambiguity group."""
SMEARED = 2.0
"""Multiple of the claim's log odds that may remain after an error was subtracted in block means, which blur its edges.
"""


@dataclass(frozen=True)
class FaultyThermometers:
    """Thermometers of one sensor with faults of their own.

    Attributes:
        group: all that are compared. columns: those that deviate.
        late: the time constant of the only one, if it lags.
        settled: it lags, or deviates as a known fault does; else the fault is intermittent, and may overlie heat at its
            place.
    """

    group: Members
    columns: tuple[str, ...]
    late: Deviation | None = None
    settled: bool = True


def faulty_thermometers(groups: tuple[Members, ...]) -> FaultyThermometers | None:
    """Return the first thermometers of several with a known fault of thermometer or place, or None.

    A lagging one lets the mean of several lag by a part of its time constant, as a missing mass would. A biased or
    intermittent one appears in the mean as a fault of another form.
    """
    for group in groups:
        late = lagging_member(group)
        if late is not None:
            return FaultyThermometers(group, (late.column,), late)
    for group in groups:
        differ = [
            deviation.column
            for each in apart(group)
            if (deviation := deviating_member(each)) is not None and fault_hypotheses(each, deviation)
        ]
        intermittent = None if differ else intermittent_member(group)
        columns = differ if intermittent is None else [intermittent.column]
        if columns:
            return FaultyThermometers(group, tuple(dict.fromkeys(columns)), settled=bool(differ))
    return None


def unlisted_fault(groups: tuple[Members, ...]) -> FaultyThermometers | None:
    """Return the first thermometer of several whose deviation has no known form and began at once, or None."""
    for group in groups:
        deviation = deviating_member(group)
        if deviation is not None and not has_thermal_onset(group, deviation):
            return FaultyThermometers(group, (deviation.column,))
    return None


def without_faults(faulty: FaultyThermometers, network: Network, record: Columns) -> Columns:
    """Return the record without the errors of faulty thermometers, and without single readings unless one lags."""
    group, columns = faulty.group, set(faulty.columns)
    j = network.sensor_names.index(group.sensor)
    measured, members = record.measured.copy(), dict(record.members)
    if faulty.late is None:
        measured[:, j] -= sum(_share_of(group, c, columns, record.time_s) for c in faulty.columns)
        del members[group.sensor]
        return replace(record, measured=measured, members=members)
    (column,) = faulty.columns
    own = np.nan_to_num(group.by_itself(group.columns.index(column), group.fine))
    since_s = record.time_s - record.time_s[0]
    bins = np.clip((since_s / group.step_s).astype(int), 0, len(own) - 1)
    off = np.where(since_s >= faulty.late.shape.onset_s, own[bins], 0.0)
    each = record.members[group.sensor].copy()
    measured[:, j] -= off / len(group.columns)
    each[:, network.sensors[j].measured.index(column)] -= off
    return replace(record, measured=measured, members=members | {group.sensor: each})


def with_faults(
    faulty: FaultyThermometers, left: Diagnosis, network: Network, start: float, still: tuple[Stuck, ...]
) -> Diagnosis:
    """Return the diagnosis of faulty thermometers together with that of the record without their errors.

    Args:
        left: diagnosis without their errors, and without stuck readings. start: of the record, s. still: stuck
            readings.
    """
    stood = stuck_effects(still)
    if faulty.late is not None:
        return _together((*stood, _late(faulty.group, faulty.late, start)), (), left)
    group = faulty.group
    node = next(s.node for s in network.sensors if s.name == group.sensor)
    if left.odds <= SMEARED * left.claim and all(e.where in (node, group.sensor) for e in left.effects):
        left = replace(left, verdict="adequate", effects=(), indistinguishable=(), network=None)
    effects, same, group = attributed(left.effects, group, node, start)
    belongs = effects != left.effects
    said = left.summary
    for before, after in zip(left.effects, effects, strict=True):
        said = said.replace(before.says, after.says) if before.says else said
    left = replace(left, effects=effects, summary=said, indistinguishable=(*left.indistinguishable, *same))
    errors: list[Effect] = []
    others: list[Alternative] = []
    for column in faulty.columns:
        each = group
        for other in set(faulty.columns) - {column}:
            each = each.without(other)
        deviation = deviating_member(each)
        told = () if deviation is None else fault_hypotheses(each, deviation)
        intermittent = None if told else intermittent_member(each)
        if deviation is not None and deviation.column == column and told:
            errors.append(_fault(each, deviation, told, start))
            others += _instead(deviation, told)
        elif intermittent is not None and intermittent.column == column:
            errors.append(_intermittent_fault(each, intermittent, start))
        elif deviation is not None and deviation.column == column and not belongs:
            errors.append(_unlisted(each, deviation, start))
    return _together((*stood, *errors), tuple(others), left)


def _together(errors: tuple[Effect, ...], same: tuple[Alternative, ...], left: Diagnosis) -> Diagnosis:
    """Return a diagnosis with the faults of single thermometers first."""
    if not errors:
        return left
    found = left.verdict != "adequate"
    verdict: Verdict = left.verdict if found else "effect found"
    unlisted = any(e.kind == "unknown" for e in errors)
    if unlisted:
        verdict = "unexplained"
    elif same and verdict == "effect found":
        verdict = "ambiguous"
    but = f"; but on this record that is indistinguishable from {_either(same, *errors)}" if same else ""
    rest = f"Beside that: {left.summary}" if found else f"Without that the twin is adequate: {_leaves(left)}."
    return replace(
        left,
        verdict=verdict,
        effects=(*errors, *left.effects),
        summary=f"{'. '.join(e.says for e in errors)}{but}. {rest}",
        network=left.network if verdict == "effect found" else None,
        next_experiment=left.next_experiment if found else None,
        indistinguishable=(*same, *left.indistinguishable),
        empirical=None,
        own_course=None if unlisted else left.own_course,
    )


def attributed(
    effects: tuple[Effect, ...], group: Members, node: str, start: float
) -> tuple[tuple[Effect, ...], tuple[Alternative, ...], Members]:
    """Return effects at the place of several thermometers, each assigned to the one thermometer or place that it
    belongs to.

    Args:
        node: place of the thermometers. start: of the record, s.

    Returns:
        effects, the ambiguity group of errors of one thermometer, and the thermometers less what heat explains.
    """
    found: list[Effect] = []
    others: list[Alternative] = []
    for effect in effects:
        here = effect.where in (node, group.sensor) and effect.kind in (*HEATS, "sensor")
        near, deviation = _came_in_with(effect, group, start) if here else (group, None)
        told = () if deviation is None else fault_hypotheses(near, deviation)
        if deviation is None or not told or (effect.kind == "heat_source" and effect.value * deviation.final < 0.0):
            found.append(effect)
        elif effect.kind == "sensor":
            found.append(_fault(near, deviation, told, start))
            others += _instead(deviation, told)
        else:
            says = f"{effect.says}; of several alike, {deviation.place} alone"
            found.append(replace(effect, where=deviation.place, says=says))
            group = group.less(deviation.column, deviation.size, deviation.shape)
    return tuple(found), tuple(others), group


def _came_in_with(effect: Effect, group: Members, start: float) -> tuple[Members, Deviation | None]:
    """Return the member whose deviation began with an effect, or None, and those that it was compared with."""
    shape = Shape(effect.shape, max(effect.onset_s - start, 0.0), effect.growth_s)
    near = group.around(shape.onset_s) if shape.name == "step" and shape.onset_s > 0.0 else group
    return near, deviating_member(near, (shape,))


def _instead(deviation: Deviation, told: tuple[FaultHypothesis, ...]) -> tuple[Alternative, ...]:
    """Return the ambiguity group of the likeliest hypothesis, itself first, unless its probability is high enough."""
    places: dict[tuple[str, bool], float] = {}
    for n in told:
        places[n.kind, n.local] = places.get((n.kind, n.local), 0.0) + n.share
    if not told or places[told[0].kind, told[0].local] >= SURE:
        return ()
    left = [n for n in told if n.share > OPEN * told[0].share]
    return tuple(Alternative(n.kind, deviation.place if n.local else deviation.column, n.driver, n.share) for n in left)


def _either(same: tuple[Alternative, ...], *faults: Effect) -> str:
    """Return the other possible causes in words."""
    said = {(e.kind, e.where) for e in faults}
    named = dict.fromkeys((a.kind, a.where) for a in same if (a.kind, a.where) not in said)
    return " or ".join(f"{kind.replace('_', ' ')} at {where}" for kind, where in named)


def _share_of(group: Members, column: str, faults: AbstractSet[str], time_s: Array) -> Array:
    """Return the part (N,), K, of its group's mean that is one thermometer's error: by bins, or by block if bins are
    missing.
    """
    alone = group
    for other in faults - {column}:
        alone = alone.without(other)
    i, since_s = alone.columns.index(column), time_s - time_s[0]
    block = np.clip(np.searchsorted(group.edges_s, since_s, side="right") - 1, 0, len(alone.residual) - 1)
    bins = np.clip((since_s / group.step_s).astype(int), 0, len(alone.fine) - 1)
    fine = alone.by_itself(i, alone.fine)[bins]
    found: Array = np.nan_to_num(np.where(np.isfinite(fine), fine, alone.by_itself(i, alone.residual)[block]))
    return found / len(group.columns)


def _leaves(left: Diagnosis) -> str:
    worst = max(left.errors, key=lambda n: left.errors[n].before / left.errors[n].noise)
    e = left.errors[worst]
    return f"at most {e.before:.2g} K on {worst} at a noise of {e.noise:.2g} K, on the held-out segment"


def _late(one: Members, deviation: Deviation, start: float) -> Effect:
    """Return the fault of a thermometer that lags behind the others of its place."""
    onset, spread = start + deviation.shape.onset_s, NORMAL90 * deviation.sd
    window_s = LATE_WINDOW_S if deviation.shape.onset_s > 0.0 else 0.0
    return Effect(
        kind="sensor",
        where=deviation.column,
        driver="rate_of_change",
        change="new",
        value=deviation.size,
        unit="s",
        interval90=(deviation.size - spread, deviation.size + spread),
        onset_s=onset,
        onset_interval90_s=(max(onset - window_s, start), onset + window_s),
        shape="step",
        confidence=deviation.share,
        z=deviation.z,
        evidence=f"it explains {100.0 * deviation.share:.0f} % of what {deviation.column} differs from the others by",
        says=f"{deviation.column} follows the other thermometers of {one.sensor} late, by "
        f"{amount(deviation.size, 's', spread)} {when(deviation.shape, start)}",
    )


def _fault(one: Members, deviation: Deviation, likely: tuple[FaultHypothesis, ...], start: float) -> Effect:
    """Return the fault of a deviating member: the likeliest hypothesis, a sensor fault if none explains it."""
    spread, drifts = NORMAL90 * deviation.sd, deviation.shape.name != "step"
    low, high = onset_interval(one, deviation)
    told = likely[0] if likely else FaultHypothesis("sensor", "elapsed_time" if drifts else "constant", False, 1.0)
    off = amount(abs(deviation.final), "K", spread)
    if told.local:
        says = f"{deviation.place} is {off} {'warmer' if deviation.final > 0.0 else 'colder'} than its neighbours tell"
        says += ", the more the warmer it is beside the room" if told.kind == "heat_loss" else ""
        says += " and more with the heater's power" if told.driver == "heater_power" else ""
        says = f"{says}, too little heat for the loop to show" + (", at the record's end," if drifts else "")
    else:
        reads = f"reads {off} too {'high' if deviation.final > 0.0 else 'low'}"
        says = f"{deviation.column} " + (f"drifts and {reads} at the record's end," if drifts else reads)
    return Effect(
        kind=told.kind,
        where=deviation.place if told.local else deviation.column,
        driver=told.driver,
        change="new",
        value=deviation.final,
        unit="K",
        interval90=(deviation.final - spread, deviation.final + spread),
        onset_s=start + deviation.shape.onset_s,
        onset_interval90_s=(start + low, start + high),
        shape=deviation.shape.name,
        confidence=min(deviation.share, told.share),
        z=deviation.z,
        evidence=f"it carries {100.0 * deviation.share:.0f} % of what differs among the thermometers of {one.sensor}",
        says=f"{says} {when(deviation.shape, start)}",
    )


def _intermittent_fault(one: Members, deviation: Deviation, start: float) -> Effect:
    """Return the fault of a thermometer that deviates now and then, with no known form."""
    onset = start + deviation.shape.onset_s
    return Effect(
        kind="unknown",
        where=deviation.column,
        driver="history",
        change="new",
        value=deviation.size,
        unit="K",
        interval90=(-deviation.size, deviation.size),
        onset_s=onset,
        onset_interval90_s=(onset, onset),
        shape="transient",
        confidence=1.0,
        z=deviation.z,
        evidence=f"the other thermometers of {one.sensor} agree with one another",
        says=f"{deviation.column} is off by up to {amount(deviation.size, 'K')} now and then, in "
        f"{100.0 * deviation.share:.0f} % of the record, for the first time at {clock(onset)}",
    )


def _unlisted(one: Members, deviation: Deviation, start: float) -> Effect:
    """Return a thermometer with a deviation of no listed form as an effect of its largest deviation."""
    good = one.good
    off = one.by_itself(one.columns.index(deviation.column), one.residual[good])
    most, onset = float(np.abs(off).max()), start + deviation.shape.onset_s
    return Effect(
        kind="unknown",
        where=deviation.column,
        driver="history",
        change="new",
        value=most,
        unit="K",
        interval90=(-most, most),
        onset_s=onset,
        onset_interval90_s=(onset, onset),
        shape=deviation.shape.name,
        confidence=deviation.share,
        z=deviation.z,
        evidence=f"the other thermometers of {one.sensor} agree with one another",
        says=f"{deviation.column} differs from its neighbours by up to {amount(most, 'K')} "
        f"{when(deviation.shape, start)}, in no "
        "way that is known of a thermometer or of its place",
    )


def stuck_effects(still: tuple[Stuck, ...]) -> tuple[Effect, ...]:
    """Return each stuck thermometer as an effect, stuck once or intermittently."""
    columns = dict.fromkeys(span.column for span in still)
    return tuple(_standing(tuple(span for span in still if span.column == column)) for column in columns)


def _standing(spans: tuple[Stuck, ...]) -> Effect:
    """Return one thermometer that was stuck in these spans."""
    first, last = spans[0], spans[-1]
    says = f"{first.column} stands still at {first.value:.2f} degC from {clock(first.first_s)} to {clock(first.last_s)}"
    if len(spans) > 1:
        still_s = sum(span.last_s - span.first_s for span in spans)
        says += f", and {len(spans) - 1} more until {clock(last.last_s)}, for {clock(still_s)} in all"
    return Effect(
        kind="sensor",
        where=first.column,
        driver="constant",
        change="new",
        value=first.value,
        unit="degC",
        interval90=(first.value, first.value),
        onset_s=first.first_s,
        onset_interval90_s=(first.first_s, first.first_s),
        shape="stuck",
        confidence=1.0,
        z=100.0,
        level=first.value,
        says=says,
        evidence="a noisy reading does not repeat itself for so long",
    )
