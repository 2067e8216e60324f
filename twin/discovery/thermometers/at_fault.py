"""Thermometers that are at fault by themselves: one that stands still, one of several that differs from the others."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from twin.discovery.diagnosis import Alternative, Diagnosis, Effect, Verdict
from twin.discovery.effects.phrases import amount, clock, when
from twin.discovery.effects.shapes import Shape
from twin.discovery.records.readings import Stuck
from twin.discovery.scoring.equivalence import width
from twin.discovery.thermometers.members import (
    LATE_WINDOW_S,
    Members,
    Odd,
    began_between,
    lagging_one,
    odd_one,
    restless_one,
)
from twin.discovery.thermometers.nature import Nature, came_slowly, natures
from twin.gauss_newton import SE90
from twin.network import Array, Network

if TYPE_CHECKING:
    from twin.discovery.evidence.finding import Finding
    from twin.discovery.healthy.basis import Columns

HEATS = ("heat_source", "heat_loss")
"""Kinds that warm or cool one place of several, whose thermometer then stands out without being at fault."""
SURE, OPEN = 0.85, 0.05
"""Share of the weight that one thing must have to be named alone, and of the likeliest one's that it must have to stay
in question."""
SMEARED = 2.0
"""Times the log odds of a claim that may be left where an error was taken off in block means: its edges are sharper."""


def without_late(
    groups: tuple[Members, ...], network: Network, record: Columns, start: float
) -> tuple[Effect, Columns] | None:
    """One thermometer of several that follows the others late, and the record without that; None where none does.

    The mean of several is late by a part of what one of them is, as by a mass that is not there.
    """
    for group in groups:
        odd = lagging_one(group)
        if odd is None:
            continue
        j = network.sensor_names.index(group.sensor)
        own = np.nan_to_num(group.by_itself(group.columns.index(odd.column), group.fine))
        since_s = record.time_s - record.time_s[0]
        bins = np.clip((since_s / group.step_s).astype(int), 0, len(own) - 1)
        off = np.where(since_s >= odd.shape.onset_s, own[bins], 0.0)
        measured, each = record.measured.copy(), record.members[group.sensor].copy()
        measured[:, j] -= off / len(group.columns)
        each[:, network.sensors[j].measured.index(odd.column)] -= off
        members = {**record.members, group.sensor: each}
        return _late(group, odd, start), replace(record, measured=measured, members=members)
    return None


def beside_late(late: Effect, left: Diagnosis) -> Diagnosis:
    """What was found without the error of a thermometer that follows late, and that error."""
    verdict: Verdict = "effect found" if left.verdict == "adequate" else left.verdict
    said = f"{late.says}. Beside that: {left.summary}"
    return replace(left, verdict=verdict, effects=(*left.effects, late), summary=said)


def _late(one: Members, odd: Odd, start: float) -> Effect:
    onset, spread = start + odd.shape.onset_s, SE90 * odd.sd
    window_s = LATE_WINDOW_S if odd.shape.onset_s > 0.0 else 0.0
    return Effect(
        kind="sensor", where=odd.column, driver="rate_of_change", change="new", value=odd.size, unit="s",
        interval90=(odd.size - spread, odd.size + spread), onset_s=onset,
        onset_interval90_s=(max(onset - window_s, start), onset + window_s), shape="step",
        confidence=odd.share, z=odd.z,
        evidence=f"it explains {100.0 * odd.share:.0f} % of what {odd.column} differs from the others by",
        says=f"{odd.column} follows the other thermometers of {one.sensor} late, by {amount(odd.size, 's', spread)} "
             f"{when(odd.shape, start)}",
    )  # fmt: skip


def single(
    one: Members, network: Network, verdict: Verdict, effects: tuple[Effect, ...], finding: Finding, start: float
) -> tuple[Verdict, tuple[Effect, ...], tuple[Alternative, ...]]:
    """Say which thermometer or place of several it is, where one differs from the others, and what else it may be.

    A mismatch that nothing explains stays unexplained, with the thermometer named beside it: whether the thermometer
    is all there is to it, `explained_by_one` tells. One that is off now and then is not of the catalogue; beside a
    cause that is named it is not looked for.
    """
    node = next(s.node for s in network.sensors if s.name == one.sensor)
    here = [i for i, e in enumerate(effects) if e.where in (node, one.sensor)]
    shapes = tuple(e.shape for e in finding.entries) if here and finding.entries else ()
    odd = odd_one(one, shapes) or (odd_one(one) if not here or verdict == "unexplained" else None)
    if odd is None:
        return (*_now_and_then(one, verdict, effects, start), ())
    at = _belongs_to(odd, here, effects, finding)
    if at is not None and effects[at].kind not in ("unknown", "sensor"):
        own = _in_its_own_shape(one, odd)
        if own is not odd and effects[at].kind not in HEATS:
            # What came in at another time, or grew, is another thing: the thermometer's own. Heat at one place shows in
            # its thermometer, in whatever form it is told.
            return verdict, (*effects, _fault(one, own, natures(one, own), start)), ()
        old = effects[at]
        changed = replace(old, where=odd.place, says=f"{old.says}; of several alike, {odd.place} alone")
        own_ones = (changed if i == at else _its_own(one, e, start) if i in here else e for i, e in enumerate(effects))
        return verdict, tuple(own_ones), ()
    if at is not None and effects[at].kind == "sensor":
        odd = _in_its_own_shape(one, odd)
    told = natures(one, odd)
    if not told and (verdict == "adequate" or (verdict == "unexplained" and came_slowly(one, odd))):
        # No error of one thermometer, nor heat of one place, that is there from one moment on.
        return (*_now_and_then(one, verdict, effects, start), ())
    restless = restless_one(one) if not told and at is not None else None
    if restless is not None:
        # What came and went at one thermometer shows in the mean as an error of another form; what else is unknown at
        # the place stays, until the record is looked at without that thermometer.
        rest = (e for i, e in enumerate(effects) if i != at or e.kind == "unknown")
        return "unexplained", (_restless(one, restless, start), *rest), ()
    fault, same = _fault(one, odd, told, start), _instead(odd, told)
    if verdict == "unexplained":
        return verdict, (*effects, fault), same
    if at is not None:
        effects = tuple(fault if i == at else e for i, e in enumerate(effects))
        return "ambiguous" if same else "effect found", effects, same
    if verdict == "adequate":
        return "ambiguous" if same else "effect found", (*effects, fault), same
    if same:
        fault = replace(fault, says=f"{fault.says} (or so it is with {_either(same, fault)}: this record cannot tell)")
    return verdict, (*effects, fault), same


def _its_own(one: Members, effect: Effect, start: float) -> Effect:
    """An error of the mean that came at one moment, as that of the thermometer which changed then, if one did."""
    if effect.kind != "sensor" or effect.shape != "step" or effect.onset_s <= start:
        return effect
    shape = Shape("step", effect.onset_s - start)
    near = one.around(shape.onset_s)
    odd = odd_one(near, (shape,))
    return effect if odd is None else _fault(near, odd, natures(near, odd), start)


def _now_and_then(
    one: Members, verdict: Verdict, effects: tuple[Effect, ...], start: float
) -> tuple[Verdict, tuple[Effect, ...]]:
    """The same with a thermometer that is off now and then; beside a cause that is named none is looked for."""
    restless = restless_one(one) if verdict in ("adequate", "unexplained") else None
    return (verdict, effects) if restless is None else ("unexplained", (*effects, _restless(one, restless, start)))


def _instead(odd: Odd, told: tuple[Nature, ...]) -> tuple[Alternative, ...]:
    """What cannot be told from the likeliest, that first, where that has not nearly all of the weight."""
    places: dict[tuple[str, bool], float] = {}
    for n in told:
        places[n.kind, n.local] = places.get((n.kind, n.local), 0.0) + n.share
    if not told or places[told[0].kind, told[0].local] >= SURE:
        return ()
    left = [n for n in told if n.share > OPEN * told[0].share]
    return tuple(Alternative(n.kind, odd.place if n.local else odd.column, n.driver, n.share) for n in left)


def _belongs_to(odd: Odd, here: list[int], effects: tuple[Effect, ...], finding: Finding) -> int | None:
    """Which effect at its place one that differs belongs to: of those that came in with it, an error of reading."""
    entries = finding.entries
    with_it = [i for i in here if i < len(entries) and entries[i].shape == odd.shape] or here
    return min(with_it, key=lambda i: effects[i].kind != "sensor", default=None)


def _in_its_own_shape(one: Members, odd: Odd) -> Odd:
    """The same thermometer's error as its neighbours show it, where that is plainer than as their mean does."""
    own = odd_one(one)
    plainer = own is not None and own.column == odd.column and own.z**2 > odd.z**2 + width(odd.z**2)
    return own if own is not None and plainer else odd


def _either(same: tuple[Alternative, ...], *faults: Effect) -> str:
    """What else it may be, in words."""
    said = {(e.kind, e.where) for e in faults}
    named = dict.fromkeys((a.kind, a.where) for a in same if (a.kind, a.where) not in said)
    return " or ".join(f"{kind.replace('_', ' ')} at {where}" for kind, where in named)


def _fault(one: Members, odd: Odd, likely: tuple[Nature, ...], start: float) -> Effect:
    """What is the matter where one differs: the likeliest thing, an error of reading where nothing explains it."""
    spread, drifts = SE90 * odd.sd, odd.shape.name != "step"
    low, high = began_between(one, odd)
    told = likely[0] if likely else Nature("sensor", "elapsed_time" if drifts else "constant", False, 1.0)
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
        kind=told.kind, where=odd.place if told.local else odd.column, driver=told.driver,
        change="new", value=odd.final, unit="K", interval90=(odd.final - spread, odd.final + spread),
        onset_s=start + odd.shape.onset_s, onset_interval90_s=(start + low, start + high), shape=odd.shape.name,
        confidence=min(odd.share, told.share), z=odd.z,
        evidence=f"it carries {100.0 * odd.share:.0f} % of what differs among the thermometers of {one.sensor}",
        says=f"{says} {when(odd.shape, start)}",
    )  # fmt: skip


def _restless(one: Members, odd: Odd, start: float) -> Effect:
    onset = start + odd.shape.onset_s
    return Effect(
        kind="unknown", where=odd.column, driver="history", change="new", value=odd.size, unit="K",
        interval90=(-odd.size, odd.size), onset_s=onset, onset_interval90_s=(onset, onset), shape="spell",
        confidence=1.0, z=odd.z, evidence=f"the other thermometers of {one.sensor} agree with one another",
        says=f"{odd.column} is off by up to {amount(odd.size, 'K')} now and then, in {100.0 * odd.share:.0f} % of the "
             f"record, for the first time at {clock(onset)}",
    )  # fmt: skip


def explained_by_one(
    found: Diagnosis,
    network: Network,
    record: Columns,
    groups: tuple[Members, ...],
    again: Callable[[Columns], Diagnosis],
) -> Diagnosis:
    """An unexplained finding looked at without the thermometer that stands out; unchanged where there is none.

    Args:
        again: diagnoses a record anew. Only if the twin is adequate without that thermometer's error, the thermometer
            is the answer: a place that is hotter than others of its kind makes its thermometer stand out too. What is
            then found elsewhere is told beside it, and at its own place if the thermometer is off only now and then.
    """
    if found.verdict != "unexplained":
        return found
    for group in groups:
        faults = {c: e for e in found.effects if (c := group.column_of(e.where)) is not None}
        if not faults:
            continue
        j = network.sensor_names.index(group.sensor)
        measured = record.measured.copy()
        measured[:, j] -= sum(_share_of(group, c, faults.keys(), record.time_s) for c in faults)
        rest = {name: each for name, each in record.members.items() if name != group.sensor}
        left = again(replace(record, measured=measured, members=rest))
        errors = tuple(faults.values())
        # What is off now and then is of no catalogue, whatever else is found.
        odd = any(e.kind == "unknown" for e in errors)
        own = () if odd else (network.sensors[j].node, group.sensor)
        beside = left.verdict in ("effect found", "ambiguous") and all(e.where not in own for e in left.effects)
        if not beside and left.verdict != "adequate" and left.odds > SMEARED * left.claim:
            return found
        stuck_ones = tuple(e for e in found.effects if e.shape == "stuck" and e not in errors)
        same = tuple(a for a in found.indistinguishable if group.column_of(a.where) in faults)
        but = f"; but this record cannot tell that from {_either(same, *errors)}" if same else ""
        rest_is = left.summary if beside else f"Without that the twin is adequate: {_leaves(left)}."
        verdict: Verdict = "unexplained" if odd else "ambiguous" if same else left.verdict if beside else "effect found"
        return replace(
            left, verdict=verdict, effects=(*stuck_ones, *errors, *(left.effects if beside else ())),
            summary=f"{'. '.join(e.says for e in errors)}{but}. {'Beside that: ' if beside else ''}{rest_is}",
            network=left.network if beside and verdict == "effect found" else None, next_experiment=None,
            indistinguishable=(*same, *(left.indistinguishable if beside else ())), empirical=None,
        )  # fmt: skip
    return found


def _share_of(group: Members, column: str, faults: AbstractSet[str], time_s: Array) -> Array:
    """What one thermometer's error puts on its group's mean (N,), K: by bins, or of the block where one is missing."""
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
    return f"at most {e.before:.2g} K on {worst} at a noise of {e.noise:.2g} K, on the part that no fit saw"


def standing(spans: tuple[Stuck, ...]) -> Effect:
    """A thermometer that shows one value and nothing else, once or from time to time."""
    first, last = spans[0], spans[-1]
    says = f"{first.column} stands still at {first.value:.2f} degC from {clock(first.first_s)} to {clock(first.last_s)}"
    if len(spans) > 1:
        still_s = sum(span.last_s - span.first_s for span in spans)
        says += f", and {len(spans) - 1} more until {clock(last.last_s)}, for {clock(still_s)} in all"
    return Effect(
        kind="sensor", where=first.column, driver="constant", change="new", value=first.value, unit="degC",
        interval90=(first.value, first.value), onset_s=first.first_s, onset_interval90_s=(first.first_s, first.first_s),
        shape="stuck", confidence=1.0, z=100.0, says=says,
        evidence="a noisy reading does not repeat itself for so long",
    )  # fmt: skip
