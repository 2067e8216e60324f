"""Tables of the zoo's trial."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from hil.bench.discovery import wilson
from hil.bench.measure import Cell, ReportTable, median
from hil.bench.zoo.score import ABSTAINED, ALIKE, CRASHED, FALSE_ALARM, MISSED, QUIET, RIGHT, WRONG, ZooScore

EDGES = (0.0, 3.0, 10.0, 30.0, 100.0, 300.0, math.inf)
SEEN = 10.0
"""True score from which an effect counts as one that a record shows."""
BIN = 12
"""Named effects in a bin of the reliability table: its 90 % interval is then some 0.2 on each side."""
UNKNOWN = "-"
"""Band of a case without an answer, whose true score is not known."""
OUTCOMES = (RIGHT, ALIKE, ABSTAINED, MISSED, WRONG, CRASHED)


def tables(done: Sequence[ZooScore], which: str) -> tuple[ReportTable, ...]:
    """Return all tables of a trial; `which` is "dev" or "sealed"."""
    hidden = [s for s in done if s.effect != "none"]
    quiet = [s for s in done if s.effect == "none"]
    return tuple(
        t
        for t in (
            _scores(hidden, quiet, which),
            _by("score", "By true score", hidden, _band, "true score"),
            _by("group", "By group of effects", hidden, lambda s: s.group, "group"),
            _by("element", "By catalogue", hidden, lambda s: "element" if s.element else "no element", "effect is"),
            _by("family", "By family", hidden, lambda s: s.family, "family"),
            _by("load", "By schedule", hidden, lambda s: s.load, "schedule"),
            _reliability(done),
            _numbers(done, hidden, quiet),
            _cases(done),
        )
        if t.rows
    )


def _count(name: str, of: Sequence[ZooScore], test: Callable[[ZooScore], bool]) -> tuple[Cell, ...]:
    hits = sum(test(s) for s in of)
    low, high = wilson(hits, len(of))
    return (name, hits, len(of), 100.0 * hits / len(of) if of else None, 100.0 * low, 100.0 * high)


def _scores(hidden: Sequence[ZooScore], quiet: Sequence[ZooScore], which: str) -> ReportTable:
    named = [s for s in hidden if s.outcome in (RIGHT, ALIKE, WRONG)]
    seen = [s for s in hidden if s.score >= SEEN]
    inside, outside = [s for s in seen if s.element], [s for s in seen if not s.element]
    left = [s for s in hidden if s.outcome == ABSTAINED and s.place is not None]
    rows = (
        _count("alarms on healthy records", quiet, lambda s: s.outcome != QUIET),
        _count(
            "a cause named on healthy records", quiet, lambda s: s.outcome == FALSE_ALARM and s.verdict != "unexplained"
        ),
        _count("kind and place right, of all", hidden, lambda s: s.outcome == RIGHT),
        _count("the same, or within the ambiguity group", hidden, lambda s: s.outcome in (RIGHT, ALIKE)),
        _count("a wrong cause named, of all", hidden, lambda s: s.outcome == WRONG),
        _count("left unexplained, of all", hidden, lambda s: s.outcome == ABSTAINED),
        _count("left unexplained: place right", left, lambda s: bool(s.place)),
        _count("missed, of all", hidden, lambda s: s.outcome == MISSED),
        _count("named: a spurious second effect", named, lambda s: s.spurious > 0),
        _count(
            f"element, score of {SEEN:g} or more: right, or within the ambiguity group",
            inside,
            lambda s: s.outcome in (RIGHT, ALIKE),
        ),
        _count(f"element, score of {SEEN:g} or more: a wrong cause named", inside, lambda s: s.outcome == WRONG),
        _count(
            f"no element, score of {SEEN:g} or more: right or left unexplained",
            outside,
            lambda s: s.outcome in (RIGHT, ALIKE, ABSTAINED),
        ),
        _count(f"no element, score of {SEEN:g} or more: a wrong cause named", outside, lambda s: s.outcome == WRONG),
        _count("no answer (an error)", [*hidden, *quiet], lambda s: s.outcome == CRASHED),
    )
    note = "sealed families, opened for this table" if which == "sealed" else "families for development"
    columns = ("what", "cases", "of", "%", "90 % from", "to")
    return ReportTable("scores", "Scores", columns, tuple(r for r in rows if r[2]), (note, DEFINITION))


DEFINITION = (
    "true score: misfit of the effect in standard deviations of noise and healthy residual, twin re-tuned to first "
    "order within what commissioning leaves open"
)


def _band(s: ZooScore) -> str:
    for low, high in zip(EDGES[:-1], EDGES[1:], strict=True):
        if low <= s.score < high:
            return f"{low:g} to {high:g}" if high < math.inf else f"above {low:g}"
    return UNKNOWN


def _by(key: str, title: str, hidden: Sequence[ZooScore], of: Callable[[ZooScore], str], name: str) -> ReportTable:
    names = sorted({of(s) for s in hidden})
    if key == "score":
        names.sort(key=lambda n: math.inf if n == UNKNOWN else float(n.removeprefix("above ").split(" ")[0]))
    rows: list[tuple[Cell, ...]] = []
    for each in names:
        found = [s for s in hidden if of(s) == each]
        rows.append(
            (
                each,
                len(found),
                *(sum(s.outcome == o for s in found) for o in OUTCOMES),
                sum(s.spurious > 0 for s in found),
            )
        )
    return ReportTable(key, title, (name, "cases", *OUTCOMES, "spurious second"), tuple(rows))


def _reliability(done: Sequence[ZooScore]) -> ReportTable:
    """Return the reliability of stated confidences: bins with as many effects each, and the calibration error.

    The calibration error is the mean over all effects of the difference in their bin (Guo et al., ICML 2017, eq. 3).
    """
    told = [(s.confidence, s.outcome == RIGHT) for s in done if s.confidence is not None]
    told.sort(key=lambda one: one[0])
    count = max(round(len(told) / BIN), 1) if told else 0
    rows: list[tuple[Cell, ...]] = []
    error = 0.0
    for k in range(count):
        part = told[k * len(told) // count : (k + 1) * len(told) // count]
        stated, hits = sum(c for c, _ in part) / len(part), sum(right for _, right in part)
        low, high = wilson(hits, len(part))
        rows.append((f"{part[0][0]:.3f} to {part[-1][0]:.3f}", len(part), stated, hits / len(part), low, high))
        error += abs(stated - hits / len(part)) * len(part) / len(told)
    columns = ("confidence", "named", "stated, mean", "right", "90 % from", "to")
    note = f"first effect named, also on healthy records; expected calibration error {error:.3f}"
    return ReportTable("reliability", "Reliability of the confidence", columns, tuple(rows), (note,))


def _numbers(done: Sequence[ZooScore], hidden: Sequence[ZooScore], quiet: Sequence[ZooScore]) -> ReportTable:
    def row(name: str, values: Sequence[float | None]) -> tuple[Cell, ...]:
        found = [v for v in values if v is not None and math.isfinite(v)]
        return (name, median(found), max(found, default=math.nan), len(found))

    over = [s.after_K / s.healthy_K for s in hidden if s.after_K is not None and s.healthy_K]
    before = [s.before_K / s.healthy_K for s in hidden if s.before_K is not None and s.healthy_K]
    rows = (
        row("true score", [s.score for s in hidden]),
        row("true score of noise alone", [s.score_of_noise for s in hidden]),
        row("held out, healthy record of commissioning, K", [s.healthy_K for s in done]),
        row("held out, re-tuned, over the healthy floor", before),
        row("held out, with the effects, over the healthy floor", over),
        row(
            "held out, healthy plants, over the healthy floor",
            [s.after_K / s.healthy_K for s in quiet if s.after_K is not None and s.healthy_K],
        ),
        row("samples", [float(s.rows) for s in done]),
        row("diagnosis, s of processors", [s.diagnose_cpu_s for s in done]),
        row("plant and commissioning, s of processors", [s.make_cpu_s for s in done]),
    )
    return ReportTable(
        "numbers", "Sizes, errors and time", ("what", "median", "worst", "cases"), tuple(r for r in rows if r[3])
    )


def _cases(done: Sequence[ZooScore]) -> ReportTable:
    rows = tuple(
        (
            s.case,
            s.family,
            s.effect,
            "yes" if s.element else "no",
            s.score,
            s.verdict,
            s.outcome,
            s.spurious,
            s.said,
            s.diagnose_cpu_s,
        )
        for s in done
    )
    columns = ("case", "family", "truth", "element", "true score", "verdict", "outcome", "spurious", "answer", "cpu s")
    return ReportTable("cases", "Cases", columns, rows)
