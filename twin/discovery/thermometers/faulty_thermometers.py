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
from twin.discovery.thermometers.fault_hypotheses import FaultHypothesis, fault_hypotheses, has_thermal_onset
from twin.discovery.thermometers.members import (
    LATE_WINDOW_S,
    Members,
    Odd,
    apart,
    began_between,
    lagging_one,
    odd_one,
    restless_one,
)
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
    late: Odd | None = None
    settled: bool = True


def faulty_thermometers(groups: tuple[Members, ...]) -> FaultyThermometers | None:
    """Return the first thermometers of several with a known fault of thermometer or place, or None.

    A lagging one lets the mean of several lag by a part of its time constant, as a missing mass would. A biased or
    intermittent one appears in the mean as a fault of another form.
    """
    for group in groups:
        late = lagging_one(group)
        if late is not None:
            return FaultyThermometers(group, (late.column,), late)
    for group in groups:
        differ = [
            odd.column for each in apart(group) if (odd := odd_one(each)) is not None and fault_hypotheses(each, odd)
        ]
        restless = None if differ else restless_one(group)
        columns = differ if restless is None else [restless.column]
        if columns:
            return FaultyThermometers(group, tuple(dict.fromkeys(columns)), settled=bool(differ))
    return None


def unlisted_fault(groups: tuple[Members, ...]) -> FaultyThermometers | None:
    """Return the first thermometer of several whose deviation has no known form and began at once, or None."""
    for group in groups:
        odd = odd_one(group)
        if odd is not None and not has_thermal_onset(group, odd):
            return FaultyThermometers(group, (odd.column,))
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
        odd = odd_one(each)
        told = () if odd is None else fault_hypotheses(each, odd)
        restless = None if told else restless_one(each)
        if odd is not None and odd.column == column and told:
            errors.append(_fault(each, odd, told, start))
            others += _instead(odd, told)
        elif restless is not None and restless.column == column:
            errors.append(_restless(each, restless, start))
        elif odd is not None and odd.column == column and not belongs:
            errors.append(_strange(each, odd, start))
    return _together((*stood, *errors), tuple(others), left)


def _together(errors: tuple[Effect, ...], same: tuple[Alternative, ...], left: Diagnosis) -> Diagnosis:
    """Return a diagnosis with the faults of single thermometers first."""
    if not errors:
        return left
    found = left.verdict != "adequate"
    verdict: Verdict = left.verdict if found else "effect found"
    strange = any(e.kind == "unknown" for e in errors)
    if strange:
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
        own_course=None if strange else left.own_course,
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
        near, odd = _came_in_with(effect, group, start) if here else (group, None)
        told = () if odd is None else fault_hypotheses(near, odd)
        if odd is None or not told or (effect.kind == "heat_source" and effect.value * odd.final < 0.0):
            found.append(effect)
        elif effect.kind == "sensor":
            found.append(_fault(near, odd, told, start))
            others += _instead(odd, told)
        else:
            says = f"{effect.says}; of several alike, {odd.place} alone"
            found.append(replace(effect, where=odd.place, says=says))
            group = group.less(odd.column, odd.size, odd.shape)
    return tuple(found), tuple(others), group


def _came_in_with(effect: Effect, group: Members, start: float) -> tuple[Members, Odd | None]:
    """Return the member whose deviation began with an effect, or None, and those that it was compared with."""
    shape = Shape(effect.shape, max(effect.onset_s - start, 0.0), effect.growth_s)
    near = group.around(shape.onset_s) if shape.name == "step" and shape.onset_s > 0.0 else group
    return near, odd_one(near, (shape,))


def _instead(odd: Odd, told: tuple[FaultHypothesis, ...]) -> tuple[Alternative, ...]:
    """Return the ambiguity group of the likeliest hypothesis, itself first, unless its probability is high enough."""
    places: dict[tuple[str, bool], float] = {}
    for n in told:
        places[n.kind, n.local] = places.get((n.kind, n.local), 0.0) + n.share
    if not told or places[told[0].kind, told[0].local] >= SURE:
        return ()
    left = [n for n in told if n.share > OPEN * told[0].share]
    return tuple(Alternative(n.kind, odd.place if n.local else odd.column, n.driver, n.share) for n in left)


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


def _late(one: Members, odd: Odd, start: float) -> Effect:
    """Return the fault of a thermometer that lags behind the others of its place."""
    onset, spread = start + odd.shape.onset_s, NORMAL90 * odd.sd
    window_s = LATE_WINDOW_S if odd.shape.onset_s > 0.0 else 0.0
    return Effect(
        kind="sensor",
        where=odd.column,
        driver="rate_of_change",
        change="new",
        value=odd.size,
        unit="s",
        interval90=(odd.size - spread, odd.size + spread),
        onset_s=onset,
        onset_interval90_s=(max(onset - window_s, start), onset + window_s),
        shape="step",
        confidence=odd.share,
        z=odd.z,
        evidence=f"it explains {100.0 * odd.share:.0f} % of what {odd.column} differs from the others by",
        says=f"{odd.column} follows the other thermometers of {one.sensor} late, by {amount(odd.size, 's', spread)} "
        f"{when(odd.shape, start)}",
    )


def _fault(one: Members, odd: Odd, likely: tuple[FaultHypothesis, ...], start: float) -> Effect:
    """Return the fault of a deviating member: the likeliest hypothesis, a sensor fault if none explains it."""
    spread, drifts = NORMAL90 * odd.sd, odd.shape.name != "step"
    low, high = began_between(one, odd)
    told = likely[0] if likely else FaultHypothesis("sensor", "elapsed_time" if drifts else "constant", False, 1.0)
    off = amount(abs(odd.final), "K", spread)
    if told.local:
        says = f"{odd.place} is {off} {'warmer' if odd.final > 0.0 else 'colder'} than its neighbours tell"
        says += ", the more the warmer it is beside the room" if told.kind == "heat_loss" else ""
        says += " and more with the heater's power" if told.driver == "heater_power" else ""
        says = f"{says}, too little heat for the loop to show" + (", at the record's end," if drifts else "")
    else:
        reads = f"reads {off} too {'high' if odd.final > 0.0 else 'low'}"
        says = f"{odd.column} " + (f"drifts and {reads} at the record's end," if drifts else reads)
    return Effect(
        kind=told.kind,
        where=odd.place if told.local else odd.column,
        driver=told.driver,
        change="new",
        value=odd.final,
        unit="K",
        interval90=(odd.final - spread, odd.final + spread),
        onset_s=start + odd.shape.onset_s,
        onset_interval90_s=(start + low, start + high),
        shape=odd.shape.name,
        confidence=min(odd.share, told.share),
        z=odd.z,
        evidence=f"it carries {100.0 * odd.share:.0f} % of what differs among the thermometers of {one.sensor}",
        says=f"{says} {when(odd.shape, start)}",
    )


def _restless(one: Members, odd: Odd, start: float) -> Effect:
    """Return the fault of a thermometer that deviates now and then, with no known form."""
    onset = start + odd.shape.onset_s
    return Effect(
        kind="unknown",
        where=odd.column,
        driver="history",
        change="new",
        value=odd.size,
        unit="K",
        interval90=(-odd.size, odd.size),
        onset_s=onset,
        onset_interval90_s=(onset, onset),
        shape="spell",
        confidence=1.0,
        z=odd.z,
        evidence=f"the other thermometers of {one.sensor} agree with one another",
        says=f"{odd.column} is off by up to {amount(odd.size, 'K')} now and then, in {100.0 * odd.share:.0f} % of the "
        f"record, for the first time at {clock(onset)}",
    )


def _strange(one: Members, odd: Odd, start: float) -> Effect:
    """Return a thermometer with a deviation of no listed form as an effect of its largest deviation."""
    good = one.good
    off = one.by_itself(one.columns.index(odd.column), one.residual[good])
    most, onset = float(np.abs(off).max()), start + odd.shape.onset_s
    return Effect(
        kind="unknown",
        where=odd.column,
        driver="history",
        change="new",
        value=most,
        unit="K",
        interval90=(-most, most),
        onset_s=onset,
        onset_interval90_s=(onset, onset),
        shape=odd.shape.name,
        confidence=odd.share,
        z=odd.z,
        evidence=f"the other thermometers of {one.sensor} agree with one another",
        says=f"{odd.column} differs from its neighbours by up to {amount(most, 'K')} {when(odd.shape, start)}, in no "
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
