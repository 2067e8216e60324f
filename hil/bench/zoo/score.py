"""Score of an answer against the answers that were declared with the effect."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.bench.discovery import NAMED, pooled, spoken

RIGHT, ALIKE, ABSTAINED, MISSED, WRONG, FALSE_ALARM, QUIET, CRASHED = (
    "right",
    "right within the ambiguity group",
    "left unexplained",
    "missed",
    "wrong",
    "false alarm",
    "quiet",
    "no answer",
)
_SAME_DRIVER = (frozenset({"history", "rate_of_change"}), frozenset({"temperature", "temperature_difference"}))


@dataclass(frozen=True, slots=True)
class ZooScore:
    """Score of one opened case.

    Attributes
    ----------
    case, family, effect, group, element
        Case, and the effect with its group; `element` is True if the catalogue holds it.
    score, score_of_noise
        True score (`visibility`), 0 for a healthy plant.
    verdict, said
        Verdict and effects of the answer.
    outcome
        One of the words of this module.
    place
        True if the first effect named, or the place of what was left unexplained, is that of the truth; None without.
    spurious
        Number of effects named beyond the first that no accepted answer covers.
    after_K, floor_K
        RMSE of the held-out part with the answer's effects, over all sensors, and the noise.
    healthy_K
        RMSE of the commissioned twin on the held-out part of the healthy record: the floor of this plant.
    diagnose_cpu_s, make_cpu_s
        Processor seconds.
    load, rows
        Kind of schedule, and samples of the record.
    confidence
        Confidence of the first effect named; None without one.
    """

    case: str
    family: str
    effect: str
    group: str
    element: bool
    score: float
    score_of_noise: float
    verdict: str
    said: str
    outcome: str
    place: bool | None
    spurious: int
    before_K: float | None
    after_K: float | None
    noise_K: float | None
    healthy_K: float | None
    diagnose_cpu_s: float
    make_cpu_s: float
    load: str = ""
    rows: int = 0
    confidence: float | None = None


def judge(
    case: str,
    truth: Mapping[str, Any],
    answer: Mapping[str, Any],
    *,
    healthy_K: float | None = None,
    diagnose_cpu_s: float = math.nan,
    make_cpu_s: float = math.nan,
) -> ZooScore:
    """Score an answer (`diagnosis.json`) against a sealed truth."""
    verdict = str(answer["verdict"])
    effects: list[Mapping[str, Any]] = list(answer["effects"])
    accepted = list(truth["answers"])
    hidden = truth["effect"] != "none"
    named = verdict in NAMED and bool(effects)
    place: bool | None = None
    spurious = 0
    if hidden and effects and truth["place"] != "loop":
        place = effects[0]["where"] in {a["where"] for a in accepted} | {truth["place"]}
    if named:
        spurious = sum(not covers(accepted, e, driver=False) for e in effects[1:])
    outcome = _outcome(verdict, hidden, named, effects, accepted, answer)
    errors = pooled(answer)
    return ZooScore(
        case=case,
        family=str(truth["family"]),
        effect=str(truth["effect"]),
        group=str(truth["group"]),
        element=bool(truth["element"]),
        score=float(truth["score"]),
        score_of_noise=float(truth["score_of_noise"]),
        verdict=verdict,
        said="; ".join(spoken(e) for e in effects) or "-",
        outcome=outcome,
        place=place,
        spurious=spurious,
        before_K=errors[0] if errors else None,
        after_K=errors[1] if errors else None,
        noise_K=errors[2] if errors else None,
        healthy_K=healthy_K,
        diagnose_cpu_s=diagnose_cpu_s,
        make_cpu_s=make_cpu_s,
        load=str(truth.get("schedule", {}).get("kind", "")),
        rows=int(truth.get("rows", 0)),
        confidence=_number(effects[0].get("confidence")) if named else None,
    )


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _outcome(
    verdict: str,
    hidden: bool,
    named: bool,
    effects: Sequence[Mapping[str, Any]],
    accepted: Sequence[Mapping[str, Any]],
    answer: Mapping[str, Any],
) -> str:
    if verdict == "crashed":
        return CRASHED
    if not hidden:
        return QUIET if verdict == "adequate" else FALSE_ALARM
    if verdict == "adequate":
        return MISSED
    if not named:
        return ABSTAINED
    if covers(accepted, effects[0]):
        return RIGHT
    others = [*answer["indistinguishable"]]
    return ALIKE if any(covers(accepted, o) for o in others) else WRONG


def covers(accepted: Sequence[Mapping[str, Any]], effect: Mapping[str, Any], *, driver: bool = True) -> bool:
    """Return True if an accepted answer has the effect's kind and place and, where it names any, its driver.

    An effect with a course of its own states that no law was found: its driver is not judged, and its heat may enter or
    leave.
    """
    own = effect.get("shape") == "own course"
    driver, kinds = driver and not own, {effect["kind"]}
    if own and "heat_source" in kinds:
        kinds.add("heat_loss")
    return any(
        a["kind"] in kinds
        and a["where"] == effect["where"]
        and (not driver or not a["drivers"] or any(_same(effect["driver"], d) for d in a["drivers"]))
        for a in accepted
    )


def _same(a: str, b: str) -> bool:
    return a == b or any({a, b} <= c for c in _SAME_DRIVER)
