"""Score of an answer against the truth: names, places, drivers, sizes, onsets, errors."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twin import NORMAL90

KindAndPlace = tuple[str, str]
"""Kind and place."""

NAMED = ("effect found", "ambiguous")
CLASSES: tuple[frozenset[KindAndPlace], ...] = (
    # All temperatures follow heat over flow: scaling one down equals scaling the other up.
    frozenset({("flow", "loop"), ("actuator", "pump_speed"), ("actuator", "heater_power")}),
    # All change the conductance from radiator to room.
    frozenset({("heat_rejection", "radiator"), ("actuator", "fan_speed"), ("heat_loss", "radiator")}),
)
"""Causes that are not or hardly distinguishable in any record of temperatures."""
_SAME_DRIVER = (
    frozenset({"history", "rate_of_change"}),
    frozenset({"temperature", "temperature_difference"}),
)
_MODULE = re.compile(r"(?<![a-z])pm\d")
SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True, slots=True)
class AnswerScore:
    """Score of one opened case; None if a question does not apply.

    Attributes
    ----------
    z, confidence
        Of the answer's first effect.
    z_truth
        Forecast for the true effect, see `discovery_ablation`.
    z_least
        Of two true effects the lesser forecast, each with the other's size fitted along.
    exact
        The kinds and places named are those of the truth, and no others.
    top1
        The first one is.
    class1
        It is, or is indistinguishable from it by the answer's own words or by physics.
    in_set
        The truth is among those that the answer does not exclude.
    set_size
        How many these are.
    in_words
        Something outside the catalogue was described by several effects of the right kind at the right place, as a loss
        that ends is by two opposite steps, or as what it is, a thermometer that stands still, or not told from what it
        is, a switch that a temperature turned.
    onset_min
        Error of the onset, minutes.
    size
        Relative error.
    errors_K
        RMSE on the held-out part, re-tuned, with the effects, and the thermometers' noise, over all sensors.
    seconds, cpu_s
        Duration of the diagnosis by the clock, and processor time.
    excess
        Share of the squared error above the floor that the effects took away.
    size_held, onset_held
        The answer's 90 % interval holds the true one.
    """

    case: str
    group: str
    what: str
    load: str
    verdict: str
    said: str
    z: float | None
    confidence: float | None
    seconds: float
    cpu_s: float
    z_truth: float | None
    exact: bool | None
    top1: bool | None
    class1: bool | None
    in_set: bool | None
    set_size: int | None
    place: bool | None
    driver: bool | None
    in_words: bool
    onset_min: float | None
    size: float | None
    errors_K: tuple[float, float, float] | None
    z_least: float | None = None
    size_held: bool | None = None
    onset_held: bool | None = None

    @property
    def named(self) -> bool:
        """Return True if a cause was named."""
        return self.verdict in NAMED

    @property
    def alarmed(self) -> bool:
        """Return True if any effect was found."""
        return self.named or self.verdict == "unexplained"

    @property
    def right(self) -> bool:
        """Return True if the answer has no error, with equivalents counted as equal; for `unexplained`, if no cause
        fits.
        """
        if self.group == "none":
            return self.verdict == "adequate"
        if self.group == "outside":
            return self.verdict == "unexplained" or self.in_words
        return self.named and bool(self.class1)


def judge(
    case: str,
    load: str,
    hidden: Mapping[str, Any],
    answer: Mapping[str, Any],
    took: tuple[float, float],
    z_truth: float | None = None,
    sizes: Sequence[tuple[float, str] | None] = (),
    z_beside: Sequence[float] = (),
) -> AnswerScore:
    """Score an answer, `diagnosis.json`, against a sealed truth.

    Parameters
    ----------
    took
        s, by the clock and of processors.
    sizes
        And units of the true effects in the catalogue, at the end of the record, None where it has no such.
    """
    group, verdict = str(hidden["group"]), str(answer["verdict"])
    effects = list(answer["effects"])
    labels = [(str(k), str(w)) for k, w, _ in hidden["labels"]]
    first = effects[0] if effects else None
    named = verdict in NAMED and bool(effects)
    said = [(e["kind"], e["where"]) for e in effects]
    others = [(a["kind"], a["where"]) for a in answer["indistinguishable"]]
    exact = top1 = class1 = in_set = right_place = right_driver = None
    set_size = onset = size = size_held = onset_held = None
    if group in ("one", "two") and named:
        exact = sorted(said) == sorted(labels)
        top1 = said[0] in labels
        class1 = all(any(alike(s, t, others) for t in labels) for s in said[: len(labels)])
        in_set = all(t in said or t in others for t in labels)
        set_size = len(set(said) | set(others))
        right_place = volume(said[0][1]) in {volume(w) for _, w in labels}
    if group == "outside" and first is not None and labels[0][1] != "loop":
        right_place = volume(first["where"]) == volume(labels[0][1])
    in_words = group == "outside" and named and _in_words(effects, answer["indistinguishable"], hidden["labels"][0])
    if first is not None and named and group == "one" and said[0] == labels[0]:
        right_driver = same_driver(first["driver"], hidden["labels"][0][2])
        began_s = hidden["effects"][0].get("onset_s", 0.0)
        onset = abs(first["onset_s"] - began_s) / SECONDS_PER_MINUTE
        onset_held = _held(first["onset_interval90_s"], began_s)
        true = sizes[0] if sizes else None
        if true is not None and true[1] == first["unit"] and true[0]:
            size = abs(first["value"] - true[0]) / abs(true[0])
            size_held = _held(first["interval90"], true[0])
    return AnswerScore(
        case=case,
        group=group,
        what=str(hidden["what"]),
        load=load,
        verdict=verdict,
        said="; ".join(spoken(e) for e in effects) or "-",
        z=first["z"] if first else None,
        confidence=first["confidence"] if first else None,
        seconds=took[0],
        cpu_s=took[1],
        z_truth=z_truth,
        exact=exact,
        top1=top1,
        class1=class1,
        in_set=in_set,
        set_size=set_size,
        place=right_place,
        driver=right_driver,
        in_words=in_words,
        onset_min=onset,
        size=size,
        errors_K=pooled(answer),
        z_least=min(z_beside, default=None),
        size_held=size_held,
        onset_held=onset_held,
    )


def _held(interval: Sequence[float], true: float) -> bool:
    return interval[0] <= true <= interval[1]


def _in_words(
    effects: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]], label: tuple[str, str, str]
) -> bool:
    """Return True if steps of one kind, place and driver describe a transient effect, a stuck sensor is called stuck,
    a switch has its place and its ambiguity, or an effect with a course of its own has its kind and place.
    """
    switch = label[2] == "threshold" and tuple(label) in {(a["kind"], a["where"], a["driver"]) for a in others}
    if len(effects) == 1 and (switch or effects[0]["shape"] in ("stuck", "own course")):
        return (effects[0]["kind"], effects[0]["where"]) == (label[0], label[1])
    told = {(e["kind"], e["where"], e["driver"], e["shape"]) for e in effects}
    kind, where, _, shape = next(iter(told))
    return (
        label[2] == "history"
        and len(told) == 1
        and len(effects) > 1
        and shape == "step"
        and alike((kind, where), (label[0], label[1]), ())
    )


def spoken(effect: Mapping[str, Any]) -> str:
    """Return an effect of an answer in one line."""
    size = f"{effect['value']:.3g} {effect['unit']}" if effect["value"] is not None else ""
    since = f"{effect['onset_s'] / 3600.0:.1f} h"
    return f"{effect['kind']} at {effect['where']} ({effect['driver']}) {size} {effect['shape']} since {since}"


def alike(said: KindAndPlace, truth: KindAndPlace, others: Sequence[KindAndPlace]) -> bool:
    """Return True if it was named, named as indistinguishable, or is of the same class."""
    if said == truth or truth in others:
        return True
    a, b = (said[0], family(said[1])), (truth[0], family(truth[1]))
    return a == b or any({a, b} <= c for c in CLASSES)


def family(where: str) -> str:
    """Return the family of a place: a module counts as the modules, its sensor as theirs."""
    return _MODULE.sub("modules", where)


def volume(where: str) -> str:
    """Return the volume of a place or a sensor."""
    inner = where.removeprefix("T_").removesuffix("_C") if where.startswith("T_") else where
    return "heater" if family(inner) == "element" else family(inner)


def same_driver(a: str, b: str) -> bool:
    """Return True if two words mean one driver."""
    return a == b or any({a, b} <= c for c in _SAME_DRIVER)


def pooled(answer: Mapping[str, Any]) -> tuple[float, float, float] | None:
    """Return the RMSE over all sensors of an answer, K: re-tuned, with its effects, noise."""
    rows = list(answer["error"]["sensors"].values())
    found = []
    for key in ("before", "after", "noise"):
        values = [r[key] for r in rows if r[key] is not None]
        if not values:
            return None
        found.append(math.sqrt(sum(v * v for v in values) / len(values)))
    return found[0], found[1], found[2]


def wilson(hits: int, of: int, z: float = NORMAL90) -> tuple[float, float]:
    """Return the 90 % interval of a share. Wilson, J. Am. Stat. Assoc. 22 (1927) 209."""
    if not of:
        return float("nan"), float("nan")
    p = hits / of
    middle = p + z * z / (2 * of)
    half = z * math.sqrt(p * (1.0 - p) / of + z * z / (4 * of * of))
    scale = 1.0 + z * z / of
    return max((middle - half) / scale, 0.0), min((middle + half) / scale, 1.0)


def risk_at_coverage(outcomes: Iterable[AnswerScore], shares: Sequence[float]) -> list[tuple[float, int, int, float]]:
    """Return for shares of the cases with a named cause, highest confidence first: share, cases, wrong ones, least
    confidence.
    """
    ranked = sorted((o for o in outcomes if o.named), key=lambda o: (-(o.confidence or 0.0), -(o.z or 0.0)))
    rows = []
    for share in shares:
        taken = ranked[: max(round(share * len(ranked)), 1)] if ranked else []
        wrong = sum(not o.right for o in taken)
        rows.append((share, len(taken), wrong, taken[-1].confidence or 0.0 if taken else float("nan")))
    return rows
