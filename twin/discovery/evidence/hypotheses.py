"""Hypotheses of the search by evidence: sets of effects with their posterior odds, and the prior of single effects."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.discovery.effects.laws import CandidateLaw
from twin.discovery.evidence.priors import CLAIM, FAULT, KINDS, UNLISTED, law_weight, sign_weight
from twin.discovery.evidence.scan import logsumexp
from twin.discovery.refit.fitting import Fit
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate

MOVED_BY = {"pump_speed": "loop", "fan_speed": "radiator", "heater_power": "heater"}
"""Place at which an actuator acts: a pump that turns slower is a smaller flow."""

Class = tuple[str, str]
Place = tuple[str, bool]
"""Place, by its thermometer or its actuator, and whether the effect there is a reading error."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Set of effects; `odds` is its log posterior odds against no effect, `fit` None while only its linear estimate is
    known, and `log_width` the prior cost of sizes beyond the usual width, which `log_bayes` contains.
    """

    entries: tuple[Entry, ...]
    log_prior: float
    log_bayes: float
    quadratic: float
    form_error: float
    log_width: float
    fit: Fit | None = None
    settled: bool = False
    gained: float = 0.0
    """Log odds by which the fit exceeds the linear estimate."""

    @property
    def odds(self) -> float:
        """Return the log posterior odds against no effect."""
        return self.log_prior + self.log_bayes

    @property
    def labels(self) -> tuple[tuple[str, str, str], ...]:
        return tuple(sorted(e.label for e in self.entries))


@dataclass(frozen=True)
class Found:
    """Hypotheses by falling odds, single effects by falling evidence, and the log odds of an unlisted effect by its
    place.
    """

    hypotheses: tuple[Hypothesis, ...]
    scanned: list[Entry]
    retuned: Fit
    unlisted_at: Mapping[Place, float]

    @property
    def unlisted(self) -> float:
        """Return the log odds of an effect of no listed form, at its likeliest place."""
        return logsumexp(np.array([*self.unlisted_at.values()])) if self.unlisted_at else -math.inf

    def rival_of(self, best: Hypothesis, expected: float) -> float:
        """Return the log odds that named effects have to reach, because of effects of no listed form.

        An unlisted effect at the same place makes the same claim, and also that no law describes its course. The second
        claim needs the odds of a claim, and more misfit than noise alone has (`expected`, per block and sensor).
        """
        own = {place_of(e.candidate) for e in best.entries}
        explained = best.fit is not None and best.fit.chi <= expected
        odds = [
            odds - (CLAIM if at in own else 0.0)
            for at, odds in self.unlisted_at.items()
            if not explained or at not in own
        ]
        return logsumexp(np.array(odds)) if odds else -math.inf

    @property
    def reported(self) -> Hypothesis | None:
        """Return the likeliest fitted hypothesis without effects that add less than `CLAIM` to its log odds.

        More effects that leave more misfit than fewer do owe their odds to errors of their forms alone.
        """
        fitted = [(h, len(h.entries), h.fit.chi) for h in self.hypotheses if h.fit is not None]
        fits = [h for h, n, chi in fitted if not any(m < n and other <= chi for _, m, other in fitted)]
        if not fits:
            return None
        enough = [h for h in fits if h.odds >= fits[0].odds - CLAIM * max(len(fits[0].entries) - len(h.entries), 0)]
        fewest = min(len(h.entries) for h in enough)
        return next(h for h in enough if len(h.entries) == fewest)


def class_of(entry: Entry) -> Class:
    """Return kind and place of an effect."""
    return entry.candidate.kind, entry.candidate.where


class Prior:
    """Prior of single effects: a fault, its class, its law in the class; named laws have most of a class."""

    def __init__(self, named: Iterable[CandidateLaw], open_candidates: Iterable[CandidateLaw] = ()) -> None:
        self._each: tuple[dict[Class, float], dict[Class, float]] = ({}, {})
        for weights, laws in zip(self._each, (named, open_candidates), strict=True):
            for law in laws:
                place = law.candidate.kind, law.candidate.where
                weights[place] = weights.get(place, 0.0) + law_weight(law.candidate)
        classes = self._each[0].keys() | self._each[1].keys()
        self._total = sum(KINDS.get(kind, 0.5) for kind, _ in classes)

    def of(self, entry: Entry) -> float:
        """Return the log probability of an effect with its sign, apart from its time course and size."""
        return math.log(FAULT) + self.share(entry.candidate) + math.log(sign_weight(entry))

    def share(self, candidate: Candidate) -> float:
        """Return the log probability that a fault is one of this law."""
        place, is_open = (candidate.kind, candidate.where), candidate.is_open
        alike, others = self._each[is_open].get(place, 1.0), self._each[not is_open].get(place, 0.0)
        share = (UNLISTED if is_open else 1.0 - UNLISTED) if others else 1.0
        weight = law_weight(candidate) / alike
        return math.log(share * weight * KINDS.get(place[0], 0.5) / self._total)


def apart(candidate: Candidate, others: Sequence[Entry]) -> bool:
    """Return True if a candidate may join other effects: each place has one effect of any form, and one thermometer
    error, but what has changed once may change again.
    """
    place = place_of(candidate)
    here = [o.candidate for o in others if place == place_of(o.candidate)]
    return all(candidate.id == c.id for c in here) and (not here or _adds_up(candidate))


def _adds_up(candidate: Candidate) -> bool:
    """Return True for a named law of which two changes are one of the sum of their sizes."""
    return not (candidate.is_open or candidate.inverse or candidate.begins or candidate.sticks or candidate.is_event)


def place_of(candidate: Candidate) -> Place:
    return place(candidate.where, candidate.kind == "sensor")


@functools.cache
def place(where: str, reads: bool) -> Place:
    named = where.removeprefix("T_").removesuffix("_C")
    return MOVED_BY.get(named, named), reads
