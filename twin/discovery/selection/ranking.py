"""Which of several fitted explanations is best, how sure that is, and when one is good enough."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from twin.discovery.diagnosis import Fold, Rung
from twin.discovery.effects.catalogue import LATE
from twin.discovery.effects.shapes import EARLY_S
from twin.discovery.refit.fitting import Fit
from twin.discovery.scoring.contest import Contest
from twin.discovery.scoring.equivalence import width
from twin.discovery.scoring.null import FALSE_ALARMS, Null
from twin.discovery.scoring.search import Entry
from twin.network import Array

LEFT, QUIET = 1.3, 3.0
"""Misfit that a twin with the right effects may leave, over what noise leaves; and where nothing known scores in it."""
LEFT_SHARE = 0.03
"""Or this share of the misfit that it began with: no effect is of quite the form assumed."""
MOMENT_S = 900.0
"""Effects that are told well enough to leave nothing over begin at the same moment if within this."""
_TYPICALS, _MOST_UNUSUAL = 20.0, 20.0
KINDS = {
    "heat_source": 1.0, "heat_loss": 1.0, "heat_rejection": 1.0, "flow": 0.7, "thermal_mass": 0.7, "sensor": 0.7,
    "coupling": 0.4, "delay": 0.5, "actuator": 0.3,
}  # fmt: skip
"""How likely a kind of effect is before any data, relative to a heat source."""
_MOVED_BY = {"pump_speed": "loop", "fan_speed": "radiator", "heater_power": "heater"}
"""What an actuator moves: a pump that turns slower is a flow that is less."""
UNDONE = 0.25
"""Share of what came that has to go for the two to be one thing that came and went."""
NEARLY_ALL = 0.85
"""Share of what a twin has that goes where something else stands in its stead."""
_RARE = {"temperature": 0.6, "fan_speed": 0.5, "pump_speed": 0.5, "heater_power": 0.5, "time_of_day": 0.3}


def enough(chi: float, start: float, contest: Contest, *, quiet: bool = False) -> bool:
    """Whether a misfit per block and sensor is as small as can be asked, for a twin that began with `start`.

    Args:
        quiet: nothing of the catalogue scores in what is left, so that it is of the twin's structure.
    """
    return chi <= max((QUIET if quiet else LEFT) * contest.expected, LEFT_SHARE * start)


def stand(fit: Fit, contest: Contest) -> bool:
    """Whether the effects of a fit may stand beside one another: they are not piled up, or leave nothing over."""
    return not piled_up(fit.entries, clean=fit.chi <= contest.expected)


def piled_up(entries: tuple[Entry, ...], *, clean: bool = False) -> bool:
    """Whether effects share a place: they then stand for one of a form that no candidate has.

    What is slow there and what is late there (a mass, a thermometer's lag) do not stand for one another, nor do a
    stream, the heat at a place and its thermometer's error, unless they begin together: what is slow or late with
    anything else there in the midst of a record.

    Args:
        clean: they leave no more than noise, as what stands for another form hardly does; then two of different kinds
            may share a place that do not begin at the same moment, and one may stand in the stead of heat that the twin
            has there.
    """
    same = [tuple(e.candidate.changes) for e in entries]
    return len(set(same)) < len(same) or any(_collide(a, b, clean) for a, b in itertools.combinations(entries, 2))


def _collide(one: Entry, other: Entry, clean: bool) -> bool:
    """Whether two effects are at one place and may not both be there."""
    if _place(one) != _place(other) or (clean and (_instead(one) or _instead(other))):
        return False
    if clean and {one.candidate.kind, other.candidate.kind} == {"delay", "heat_loss"}:
        return False  # a further length of hose loses heat
    together_s = MOMENT_S if clean else EARLY_S
    apart_s = abs(one.shape.onset_s - other.shape.onset_s)
    if _way(one) == _way(other):
        return not clean or apart_s <= together_s or _one_thing(one, other)
    amid = min(one.shape.onset_s, other.shape.onset_s) > EARLY_S
    return apart_s < together_s and (amid or "late" not in (_way(one), _way(other)))


def _instead(entry: Entry) -> bool:
    """Whether an effect takes away all that the twin has of something, so that another may stand in its stead."""
    c = entry.candidate
    return c.change == "existing" and c.kind == "heat_source" and entry.size < NEARLY_ALL * c.lower < 0.0


def _place(entry: Entry) -> str:
    """The volume or stream that an effect is at, named by itself, by its thermometer or by what moves it."""
    named = entry.candidate.where.removeprefix("T_").removesuffix("_C")
    return _MOVED_BY.get(named, named)


def _one_thing(one: Entry, other: Entry) -> bool:
    """Whether one may undo or form the other, so that the two are one thing that came and went, or of another form."""
    moved = all(
        e.candidate.where in ("pump_speed", "fan_speed") or e.candidate.kind in ("flow", "heat_rejection")
        for e in (one, other)
    )
    heats = sorted(abs(e.size) * float(np.abs(e.vector).sum(axis=0).max()) for e in (one, other))
    opposite = one.size * one.vector.sum() * other.size * other.vector.sum() < 0.0 and heats[0] > UNDONE * heats[1]
    return (
        one.candidate.kind == other.candidate.kind
        or moved
        or (opposite and min(one.shape.onset_s, other.shape.onset_s) > EARLY_S)
    )


def _way(entry: Entry) -> str:
    """What an effect is at its place: a thing of heat, of the stream, of the reading or of being late."""
    c = entry.candidate
    if c.driver in LATE:
        return "late"
    if c.kind == "sensor":
        return "reading"
    return "stream" if c.kind == "flow" or c.where == "pump_speed" else "heat"


@dataclass(frozen=True)
class Ranked:
    """A set of effects, fitted: `cost` is -2 log likelihood and complexity up to a constant, `weight` its share.

    By evidence, `cost` is -2 times the log posterior odds, and `log_bayes` what the record alone says.
    """

    fit: Fit
    cost: float
    weight: float
    log_bayes: float = 0.0

    @property
    def entries(self) -> tuple[Entry, ...]:
        return self.fit.entries


@dataclass(frozen=True)
class Finding:
    """What the search ended with; `fit` is None where nothing passed the threshold, `beside` still scores with it.

    `shorter` is what it had found before its last effect, None where that was the only one; `refuted` where one more
    scored, but did not foretell; `formed` where one more did, but only mended the form of one that is told. By
    evidence, `odds` are the log posterior odds of the likeliest effects against none, `unlisted` those of an unknown of
    no listed form, and `together` are two effects that explain the record and begin at one moment.
    """

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
    null: Null
    folds: tuple[Fold, ...] = ()
    beside: Entry | None = None
    shorter: Finding | None = None
    refuted: bool = False
    formed: bool = False
    odds: float = -math.inf
    unlisted: float = -math.inf
    together: tuple[Entry, Entry] | None = None

    @property
    def threshold(self) -> float:
        """Score below which nothing is claimed."""
        return self.null.quantile(FALSE_ALARMS)


def rank(trials: list[tuple[Fit, tuple[Entry, ...]]], contest: Contest, start: float) -> tuple[Ranked, ...]:
    """Fits by cost; weights are tempered by `width`. `start` is the misfit without any effect.

    What is plausible beforehand counts once, in the weights, and never in the cost: the cost says what data tell.
    """
    costs = []
    for fitted, _ in trials:
        cost = fitted.total
        for e in fitted.entries:
            free = 1.0 + (e.shape.onset_s > 0.0) + e.shape.grows
            cost += free * math.log(contest.count)
        costs.append(cost + unusual(fitted.entries))
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


def unusual(entries: tuple[Entry, ...]) -> float:
    """Cost of sizes far beyond the typical in -2 log likelihood: a kilowatt of which a record holds the edge alone."""
    return sum(min((e.size / (_TYPICALS * e.candidate.typical)) ** 2, _MOST_UNUSUAL) for e in entries)


def _without_growth(entries: tuple[Entry, ...], trials: list[tuple[Fit, tuple[Entry, ...]]]) -> list[int]:
    """Trials with the same candidates, the last of which comes in at once where here it grows."""
    last = entries[-1]
    if not last.shape.grows:
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
    value = KINDS.get(entry.candidate.kind, 0.5) * _RARE.get(entry.candidate.driver, 1.0)
    if entry.shape.grows and entry.candidate.kind == "actuator":
        value *= 0.2
    return value * (0.5 if entry.shape.name == "saturating" else 1.0)
