"""Result of a diagnosis: plain data, and the JSON document of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from twin.network import Array, Network

if TYPE_CHECKING:
    from twin.discovery.places.empirical import Empirical

Verdict = Literal["adequate", "effect found", "ambiguous", "unexplained"]
Carried = Literal["over", "in part", "not"]


@dataclass(frozen=True)
class Effect:
    """One effect in the vocabulary of the diagnosis; `interval90` of `value` in `unit`; times in the record's own, s.

    `says` is the effect in plain words, `evidence` what supports it. `family_wise`: probability that noise alone scores
    as much somewhere in the catalogue; NaN for an effect that no scan has found. `noise_z`: score that noise alone
    reaches there in one record of a hundred; NaN where that is the diagnosis's threshold. `level`: that of a limit, in
    the unit of its command, or the reading, degC, at which a thermometer sticks.
    """

    kind: str
    where: str
    driver: str
    change: str
    value: float
    unit: str
    interval90: tuple[float, float]
    onset_s: float
    onset_interval90_s: tuple[float, float]
    shape: str
    confidence: float
    z: float
    evidence: str
    growth_s: float = 0.0
    says: str = ""
    family_wise: float = float("nan")
    noise_z: float = float("nan")
    level: float | None = None


@dataclass(frozen=True)
class Alternative:
    """Another explanation, and why it was rejected; `why_not` is "" if nothing in the record excludes it."""

    kind: str
    where: str
    driver: str
    confidence: float
    why_not: str = ""


@dataclass(frozen=True)
class SensorError:
    """RMSE, K, of free runs over the held-out segment; `means` are the same of means over ten seconds or a sample.

    stale: commissioned twin. before: its tunables fitted anew. after: with the effects. noise: of the thermometer.
    usual: of such means, the error to expect in health where the rig moves as it does there; 0 without a healthy
    record. moved: of such means, the change that the effects predict beyond re-tuning.
    """

    stale: float
    before: float
    after: float
    noise: float
    means: tuple[float, float, float] = (float("nan"),) * 3
    usual: float = 0.0
    moved: float = 0.0


@dataclass(frozen=True)
class Elsewhere:
    """Errors over all of a further record.

    `carried`: whether the diagnosed twin has no larger error there than usual, a large one that is far below that of
    re-tuning, or neither. `says` is that in words; "" if the error is usual, or if the verdict has reported already
    that an effect is missing and was not added.
    """

    name: str
    errors: Mapping[str, SensorError]
    carried: Carried
    says: str = ""


@dataclass(frozen=True)
class Moved:
    """One tunable: commissioned, after re-tuning alone, and with the effects; also in standard deviations."""

    parameter: str
    commissioned: float
    before: float
    after: float
    unit: str
    before_sd: float
    after_sd: float


@dataclass(frozen=True)
class Course:
    """Unknown quantity at one site over time: `mean` and `sd` (b,) at `hours` (b,), in `unit`.

    `signature` is its physical type: energy, transport or sensor; `kind` and `where` are its kind of fault and place in
    the vocabulary of the diagnosis. `left`: weighted squares that it leaves of the record's misfit.
    """

    site: str
    unit: str
    hours: Array
    mean: Array
    sd: Array
    log_evidence: float
    signature: str = "energy"
    where: str = ""
    kind: str = "heat_source"
    left: float = float("nan")


@dataclass(frozen=True)
class Fold:
    """One cross-validation fold: `gain` is the fall of its weighted squares by effects whose sizes the other folds
    gave.

    `rows` is its number of block means; `first_s`, `last_s` are times of the record, s.
    """

    first_s: float
    last_s: float
    rows: int
    gain: float


@dataclass(frozen=True)
class OwnCourse:
    """Claim of an effect that follows nothing recorded; `others` are the kinds and places that the record leaves."""

    verdict: Verdict
    effects: tuple[Effect, ...]
    others: tuple[Alternative, ...]


LeadKind = Literal["segment", "input range", "outside healthy range", "place", "row"]


@dataclass(frozen=True)
class Lead:
    """A hint of where to look in what is left unexplained, beyond noise.

    Attributes
    ----------
    says
        In plain words, a sentence without a full stop.
    where
        Input column of a range, place of an unknown quantity, columns of a row; "" of a segment.
    low, high
        Range of the input in `unit`; of the place's quantity in `unit`; else first and last time, s of the record or
        numbers of steady states.
    share
        Of the squares left beyond noise that lies there, 0 to 1; NaN of a place or a row.
    of_record
        Share of the record that is there; NaN of a place or a row.
    """

    kind: LeadKind
    says: str
    where: str
    low: float
    high: float
    unit: str
    share: float = float("nan")
    of_record: float = float("nan")


@dataclass(frozen=True)
class Rung:
    """One step of the ladder: effects, misfit left (chi per block and sensor), and the best next score."""

    what: str
    chi: float
    best_z: float


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis; `network` is the twin with its effects, None if there is nothing to add.

    Attributes:
        summary: the verdict in plain words. courses: unknown power and offset per site. hours, residual: block means
            (b,), (b, m) K of measured minus simulated by the commissioned twin; residual_after: likewise with the
            effects; band: (m,) sd of a healthy residual, K.
        empirical: a curve that is offered if no effect explains the record. warnings: a sentence each.
        folds: cross-validation folds, and the gain of the effects in each.
        odds: log posterior odds of the likeliest effects against none. claim: log odds from which they are claimed.
        threshold: of a grown twin, score that the best effect reaches by noise in one record of a hundred.
        method: `contest` of effects with a commissioned twin, or `growth` of a twin that was never commissioned;
            `growth at rest` from steady states, whose times are their numbers from 1.
        own_course: claim of an effect without a law, made if no other explains the record.
        read: messages of the record's reader: what it left out, repaired or asks.
        elsewhere: errors on further records. leads: segments, ranges and places to investigate in the remaining misfit.
    """

    verdict: Verdict
    summary: str
    effects: tuple[Effect, ...]
    indistinguishable: tuple[Alternative, ...]
    alternatives: tuple[Alternative, ...]
    held_out_s: tuple[float, float]
    errors: Mapping[str, SensorError]
    moved: tuple[Moved, ...]
    blind_spots: tuple[str, ...]
    ladder: tuple[Rung, ...]
    courses: tuple[Course, ...]
    hours: Array
    residual: Array
    residual_after: Array
    band: Array
    network: Network | None
    next_experiment: Mapping[str, Any] | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    description: Mapping[str, Any] = field(default_factory=dict)
    folds: tuple[Fold, ...] = ()
    threshold: float = float("nan")
    odds: float = float("nan")
    claim: float = float("nan")
    empirical: Empirical | None = None
    method: Literal["contest", "growth", "growth at rest"] = "contest"
    elsewhere: tuple[Elsewhere, ...] = ()
    leads: tuple[Lead, ...] = ()
    own_course: OwnCourse | None = None
    read: tuple[str, ...] = ()

    def document(self) -> dict[str, Any]:
        """Return the content of ``diagnosis.json``."""
        return {
            "verdict": self.verdict,
            "method": self.method,
            "summary": self.summary,
            "effects": [_effect(e) for e in self.effects],
            "indistinguishable": [_other(a) for a in self.indistinguishable],
            "alternatives": [{**_other(a), "why_not": a.why_not} for a in self.alternatives],
            "error": {
                "held_out_s": list(self.held_out_s),
                "sensors": {name: _error(e) for name, e in self.errors.items()},
            },
            "further_records": [
                {
                    "record": one.name,
                    "carried": one.carried,
                    "sensors": {name: _error(e) for name, e in one.errors.items()},
                }
                for one in self.elsewhere
            ],
            "tunables_moved": [
                {
                    "parameter": m.parameter,
                    "commissioned": _round(m.commissioned),
                    "before": _round(m.before),
                    "after": _round(m.after),
                    "unit": m.unit,
                    "before_sd": _round(m.before_sd),
                    "after_sd": _round(m.after_sd),
                }
                for m in self.moved
            ],
            "blind_spots": list(self.blind_spots),
            "next_experiment": self.next_experiment,
            "empirical": self.empirical.document() if self.empirical else None,
            "ladder": [{"twin": r.what, "misfit": _round(r.chi), "best_next_z": _round(r.best_z)} for r in self.ladder],
            "threshold": _round(self.threshold),
            "log_odds": _finite(self.odds),
            "log_odds_to_claim": _finite(self.claim),
            "left_out": [
                {"first_s": _round(f.first_s), "last_s": _round(f.last_s), "gain": _round(f.gain)} for f in self.folds
            ],
            "description": dict(self.description),
            "leads": [_lead(one) for one in self.leads],
            "warnings": list(self.warnings),
            "notes": list(self.notes),
            "read": list(self.read),
        }


def _effect(e: Effect) -> dict[str, Any]:
    return {
        "kind": e.kind,
        "where": e.where,
        "driver": e.driver,
        "change": e.change,
        "value": _round(e.value),
        "unit": e.unit,
        "interval90": [_round(x) for x in e.interval90],
        "onset_s": _round(e.onset_s),
        "onset_interval90_s": [_round(x) for x in e.onset_interval90_s],
        "shape": e.shape,
        "level": None if e.level is None else _round(e.level),
        "confidence": _round(e.confidence),
        "z": _round(e.z),
        "p_family_wise": _round(e.family_wise),
        "noise_z": _round(e.noise_z),
        "evidence": e.evidence,
        "says": e.says,
    }


def _error(e: SensorError) -> dict[str, Any]:
    return {
        "stale": _round(e.stale),
        "before": _round(e.before),
        "after": _round(e.after),
        "noise": _round(e.noise),
        "ten_second_means": dict(zip(("stale", "before", "after"), map(_round, e.means), strict=True)),
    }


def _lead(one: Lead) -> dict[str, Any]:
    return {
        "kind": one.kind,
        "where": one.where,
        "low": _round(one.low),
        "high": _round(one.high),
        "unit": one.unit,
        "share": _round(one.share),
        "of_record": _round(one.of_record),
        "says": one.says,
    }


def _other(a: Alternative) -> dict[str, Any]:
    return {"kind": a.kind, "where": a.where, "driver": a.driver, "confidence": _round(a.confidence)}


def _finite(value: float) -> float | None:
    return _round(value) if math.isfinite(value) else None


def _round(value: float) -> float | None:
    return float(f"{value:.5g}") if value == value else None
