"""Score of warnings against the truth: found within two windows, false alarms a day, errors of onset and size."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.bench.effects.simulated import EARLY_S, Watched
from hil.bench.zoo.plants import Array
from twin.calibrators.hiera_unet.effects.balance import Hypothesis
from twin.calibrators.hiera_unet.effects.courses import Course

DAY_S = 86_400.0
VISIBLE = 10.0
"""True score of the first two windows from which a case is visible: the zoo counts an effect as shown from it on."""
SAME_S = 7200.0
"""Warnings less than this apart are one alarm."""
FALSE_A_DAY = 0.01
"""False alarms a day that are allowed."""


@dataclass(frozen=True)
class Case:
    """One record: the courses of a method with the effect and without it, and the truth."""

    course: Course
    calm: Course
    hypotheses: tuple[Hypothesis, ...]
    record: Watched


@dataclass(frozen=True)
class Outcome:
    """Outcome of one case at a threshold; `delay_s` None if the effect is not found by the end of the record.

    `intime` is True if a warning came within two windows of the onset. `right_place`, `right_kind` and the errors are
    then of the last answer within two windows, else of the first warning. `right_at_once` is of the first warning in
    either case. `early` is a warning before the onset.
    """

    truth: dict[str, Any]
    delay_s: float | None
    intime: bool
    right_place: bool
    right_kind: bool
    right_at_once: bool
    early: bool
    since_error_s: float
    since_inside: bool
    size_error: float
    size_inside: bool

    @property
    def found(self) -> bool:
        """Return True if a warning came in time and the answer at the end of the second window names the place."""
        return self.intime and self.right_place


def alarms(course: Course, end_s: Array, threshold: float, until_s: float = math.inf) -> int:
    """Return the number of alarms before a time."""
    times = end_s[(course.statistic > threshold) & (end_s <= until_s)]
    return int(len(times) > 0) + int((np.diff(times) > SAME_S).sum())


def days(end_s: Array) -> float:
    """Return the length of a record, days."""
    return float(end_s[-1]) / DAY_S


def threshold_for(courses: Sequence[tuple[Course, Array]], a_day: float = FALSE_A_DAY) -> float:
    """Return the least threshold with at most so many alarms a day on healthy records (course and ends of windows)."""
    total = sum(days(end) for _, end in courses)
    peaks = np.unique(np.concatenate([c.statistic for c, _ in courses]))
    low, high = 0, len(peaks) - 1
    while low < high:
        middle = (low + high) // 2
        if sum(alarms(c, end, float(peaks[middle])) for c, end in courses) <= a_day * total:
            high = middle
        else:
            low = middle + 1
    return float(peaks[low])


def outcome(case: Case, threshold: float) -> Outcome:
    """Return the outcome of a case."""
    truth, course = case.record.truth, case.course
    end, acts = case.record.figures.end_s, float(truth["acts_s"])
    on = course.statistic > threshold
    after = np.flatnonzero(on & (end > acts))
    delay = float(end[after[0]] - acts) if after.size else None
    place = kind = at_once = False
    intime = delay is not None and delay <= EARLY_S[0]
    since_error = size_error = math.nan
    since_inside = size_inside = False
    if delay is not None:
        k = int(after[0])
        at_once = case.hypotheses[int(course.hypothesis[k])].where in truth["places"]
        if intime:
            k = int(np.searchsorted(end, acts + EARLY_S[0], side="right")) - 1
        named = case.hypotheses[int(course.hypothesis[k])]
        place = named.where in truth["places"]
        kind = [named.named, named.where] in [list(a) for a in truth["answers"]]
        true_since = float(end[k] - acts)
        since_error = float(course.since_s[k] - true_since)
        since_inside = bool(course.since_low_s[k] <= true_since <= course.since_high_s[k])
        true = float(case.record.size[k])
        wanted = {"W": "heat_source", "K": "sensor"}.get(str(truth["unit"]))
        if place and named.kind == wanted and math.isfinite(true) and true != 0.0:
            size_error = float(course.size[k] / true - 1.0)
            size_inside = bool(course.size_low[k] <= true <= course.size_high[k])
    return Outcome(
        truth,
        delay,
        intime,
        place,
        kind,
        at_once,
        bool((on & (end <= acts)).any()),
        since_error,
        since_inside,
        size_error,
        size_inside,
    )


def judged(cases: Iterable[Case], threshold: float) -> tuple[list[Outcome], int, float]:
    """Return the outcomes, the number of false alarms on the records without effects, and their days."""
    cases = list(cases)
    false = sum(alarms(c.calm, c.record.calm.end_s, threshold) for c in cases)
    return [outcome(c, threshold) for c in cases], false, sum(days(c.record.calm.end_s) for c in cases)


def visible(outcomes: Sequence[Outcome], least: float = VISIBLE, most: float = math.inf) -> list[Outcome]:
    """Return the cases by the true score of their first two windows."""
    return [o for o in outcomes if least <= float(o.truth["early"][0]) < most]


def share(outcomes: Sequence[Outcome], test: Callable[[Outcome], bool]) -> float | None:
    """Return the share of cases that pass a test, %."""
    return 100.0 * sum(test(o) for o in outcomes) / len(outcomes) if outcomes else None
