"""Tables of `hil bench discovery`: counts with 90 % Wilson intervals, and every failure by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from hil.bench.discovery.score import AnswerScore, alike, risk_at_coverage, wilson
from hil.bench.discovery.trial import FinishedCase, TrialSize
from hil.bench.measure import Cell, ReportTable, median, number

Z_EDGES = (0.0, 3.0, 6.0, 10.0, 20.0, 50.0, math.inf)
SEEN = 5.0
"""Score of the truth above which it should be named."""
CLEAR = 20.0
"""Score above which chance has little influence on an effect's size."""
COVERAGES = (0.25, 0.5, 0.75, 0.9, 1.0)
GROUP_NAMES = {
    "none": "nothing",
    "one": "one effect of the catalogue",
    "two": "two of them",
    "outside": "not in the catalogue",
}


def tables(done: Sequence[FinishedCase], size: TrialSize) -> tuple[ReportTable, ...]:
    """Return all tables of the report."""
    outcomes = [f.outcome for f in done]
    how = _how(size)
    return tuple(
        t
        for t in (
            _scores(outcomes, how),
            _verdicts(outcomes),
            _numbers(outcomes),
            _by_z(outcomes),
            _risk(outcomes),
            _ablations(done),
            _by_load(outcomes),
            _failures(done, size),
        )
        if t.rows
    )


def _how(size: TrialSize) -> str:
    wires = (
        "plant, instruments and thermocouple module stepped directly, without Modbus and CAN"
        if size.direct
        else "replayed by the loop of `hil run` over Modbus and CAN"
    )
    kept = "" if size.known_healthy else ", which the diagnosis does not get"
    return f"records of {size.hours:g} h, {wires}; twin {size.twin}.toml, commissioned on ten healthy hours{kept}"


def _share(name: str, hits: int, of: int) -> tuple[Cell, ...]:
    low, high = wilson(hits, of)
    return (name, hits, of, 100.0 * hits / of if of else None, 100.0 * low, 100.0 * high)


def _count(name: str, outcomes: Sequence[AnswerScore], test: Callable[[AnswerScore], bool | None]) -> tuple[Cell, ...]:
    found = [bool(v) for o in outcomes if (v := test(o)) is not None]
    return _share(name, sum(found), len(found))


def _scores(outcomes: Sequence[AnswerScore], how: str) -> ReportTable:
    none = [o for o in outcomes if o.group == "none"]
    inside = [o for o in outcomes if o.group in ("one", "two")]
    one = [o for o in inside if o.group == "one"]
    two = [o for o in inside if o.group == "two"]
    outside = [o for o in outcomes if o.group == "outside"]
    seen = [o for o in inside if o.alarmed]
    abstained = [o for o in outcomes if o.verdict == "unexplained"]
    rows = [
        _count("false alarms on healthy records", none, lambda o: o.alarmed),
        _count("a wrong cause named on healthy records", none, lambda o: o.named),
        _count("one effect: something found", one, lambda o: o.alarmed),
        _count("one effect: kind and place right, of all", one, lambda o: bool(o.top1)),
        _count("one effect: the same, and nothing else", one, lambda o: bool(o.exact)),
        _count("one effect: right within the ambiguity group, of all", one, lambda o: bool(o.class1)),
        _count("one effect: right within the ambiguity group, of named", one, lambda o: o.class1),
        _count("one effect: truth in the set, of named", one, lambda o: o.in_set),
        _count("one effect: place right, of named", one, lambda o: o.place),
        _count("one effect: driver right, of those with kind and place right", one, lambda o: o.driver),
        *_visible([o for o in one if (o.z_truth or 0.0) >= SEEN]),
        _count("two effects: both right", two, lambda o: bool(o.exact)),
        _count(
            f"two effects, the lesser with a score of {SEEN:g} or more: both right or within the ambiguity group",
            [o for o in two if (o.z_least or 0.0) >= SEEN],
            lambda o: bool(o.in_set and o.class1),
        ),
        _count("two effects: the first right within the ambiguity group", two, lambda o: bool(o.class1)),
        _count("two effects: both in the set, of named", two, lambda o: o.in_set),
        _count("catalogue, something found: left unexplained", seen, lambda o: o.verdict == "unexplained"),
        _count("not in the catalogue: left unexplained (recall)", outside, lambda o: o.verdict == "unexplained"),
        _count("left unexplained: rightly (precision)", abstained, lambda o: o.group == "outside"),
        _count("not in the catalogue: described by effects of the right kind and place", outside, lambda o: o.in_words),
        _count("not in the catalogue: a wrong cause named", outside, lambda o: o.named and not o.in_words),
        _count(
            "not in the catalogue, left unexplained: place right",
            [o for o in outside if o.verdict == "unexplained"],
            lambda o: o.place,
        ),
        _count("one effect: 90 % interval of the size holds it", one, lambda o: o.size_held),
        _count("one effect: 90 % interval of the onset holds it", one, lambda o: o.onset_held),
        _count("no answer (an error)", outcomes, lambda o: o.verdict == "crashed"),
    ]
    columns = ("what", "cases", "of", "%", "90 % from", "to")
    return ReportTable("scores", "Scores", columns, tuple(r for r in rows if r[2]), (how,))


def _visible(one: Sequence[AnswerScore]) -> tuple[tuple[Cell, ...], ...]:
    """Return the counts of single effects that the record can show."""
    name = f"one effect with a score of {SEEN:g} or more"
    return (
        _count(f"{name}: right within the ambiguity group", one, lambda o: bool(o.class1)),
        _count(f"{name}: named wrongly", one, lambda o: o.named and not o.class1),
        _count(f"{name}: truth in the set", one, lambda o: bool(o.in_set or o.class1)),
    )


def _verdicts(outcomes: Sequence[AnswerScore]) -> ReportTable:
    names = ("adequate", "effect found", "ambiguous", "unexplained", "crashed")
    rows: list[tuple[Cell, ...]] = []
    for group, name in GROUP_NAMES.items():
        found = [o.verdict for o in outcomes if o.group == group]
        if found:
            rows.append((name, len(found), *(found.count(v) for v in names)))
    return ReportTable("verdicts", "Verdicts", ("truth", "cases", *names), tuple(rows))


def _numbers(outcomes: Sequence[AnswerScore]) -> ReportTable:
    inside = [o for o in outcomes if o.group in ("one", "two") and o.named]
    one = [o for o in inside if o.group == "one"]
    errors = [o.errors_K for o in inside if o.errors_K]
    times = [o.seconds for o in outcomes if o.seconds == o.seconds]
    used = [o.cpu_s for o in outcomes if o.cpu_s == o.cpu_s]
    onset = [o.onset_min for o in one if o.onset_min is not None]
    size = [100.0 * o.size for o in one if o.size is not None]
    clear = [100.0 * o.size for o in one if o.size is not None and (o.z_truth or 0.0) >= CLEAR]
    floor = [o.errors_K[0] for o in outcomes if o.group == "none" and o.errors_K]
    sets = [float(o.set_size) for o in inside if o.set_size is not None]
    rows: list[tuple[Cell, ...]] = [
        ("error of the onset, minutes", median(onset), max(onset, default=float("nan")), len(onset)),
        ("error of the size, %", median(size), max(size, default=float("nan")), len(size)),
        (f"the same, true score of {CLEAR:g} or more", median(clear), max(clear, default=float("nan")), len(clear)),
        ("causes not excluded", median(sets), max(sets, default=float("nan")), len(sets)),
        ("causes not excluded, mean", sum(sets) / len(sets) if sets else float("nan"), None, len(sets)),
        (
            "held out, re-tuned, K",
            median([e[0] for e in errors]),
            max((e[0] for e in errors), default=float("nan")),
            len(errors),
        ),
        (
            "held out, with the effects, K",
            median([e[1] for e in errors]),
            max((e[1] for e in errors), default=float("nan")),
            len(errors),
        ),
        ("held out, healthy records, re-tuned, K", median(floor), max(floor, default=float("nan")), len(floor)),
        ("noise of the thermometers, K", median([e[2] for e in errors]), None, len(errors)),
        ("seconds a record", median(times), max(times, default=float("nan")), len(times)),
        ("seconds of processors a record", median(used), max(used, default=float("nan")), len(used)),
    ]
    return ReportTable("numbers", "Sizes, onsets, errors and time", ("what", "median", "worst", "cases"), tuple(rows))


def _by_z(outcomes: Sequence[AnswerScore]) -> ReportTable:
    rows = []
    for low, high in zip(Z_EDGES[:-1], Z_EDGES[1:], strict=True):
        found = [o for o in outcomes if o.group == "one" and o.z_truth is not None and low <= o.z_truth < high]
        if found:
            name = f"{low:g} to {high:g}" if high < math.inf else f"above {low:g}"
            seen = [o for o in found if o.alarmed]
            rows.append(
                (
                    name,
                    len(found),
                    len(seen),
                    sum(bool(o.top1) for o in found),
                    sum(bool(o.class1) for o in found),
                    sum(bool(o.in_set) for o in found),
                    sum(o.verdict == "unexplained" for o in found),
                )
            )
    note = "score that the true effect would get at its true size, tunables projected out"
    columns = ("z of the truth", "cases", "found", "right", "within the ambiguity group", "in the set", "unexplained")
    return ReportTable("z", "One effect, by its visibility", columns, tuple(rows), (note,))


def _risk(outcomes: Sequence[AnswerScore]) -> ReportTable:
    rows = [
        (f"surest {share:.0%}", n, wrong, 100.0 * wrong / n if n else None, least)
        for share, n, wrong, least in risk_at_coverage(outcomes, COVERAGES)
    ]
    columns = ("of all cases with a named cause", "cases", "wrong", "%", "least confidence")
    note = "a cause named on a healthy record, or for something outside the catalogue, counts as wrong"
    return ReportTable("risk", "Risk and coverage", columns, tuple(rows), (note,))


METHODS = (
    ("linear", "no joint fit, no verdict"),
    ("raw", "nor tunables projected out"),
    ("sindy", "pysindy on the heat that is missing"),
)


def _ablations(done: Sequence[FinishedCase]) -> ReportTable:
    tried = [f for f in done if f.ablation and not f.ablation.get("failed")]
    one = [f for f in tried if f.outcome.group == "one"]
    none = [f for f in tried if f.outcome.group == "none"]
    outside = [f for f in tried if f.outcome.group == "outside"]
    if not tried:
        return ReportTable("ablations", "Ablations", (), ())
    rows: list[tuple[Cell, ...]] = [
        (
            "complete",
            len(one),
            sum(bool(f.outcome.top1) for f in one),
            sum(bool(f.outcome.class1) for f in one),
            len(none),
            sum(f.outcome.alarmed for f in none),
            len(outside),
            sum(f.outcome.named and not f.outcome.in_words for f in outside),
        )
    ]
    for key, name in METHODS:
        if not any(key in (f.ablation or {}) for f in tried):
            continue
        right = [_first(f, key) for f in one]
        rows.append(
            (
                name,
                len(one),
                sum(r[0] for r in right),
                sum(r[1] for r in right),
                len(none),
                sum(_seen(f, key) for f in none),
                len(outside),
                sum(_seen(f, key) for f in outside),
            )
        )
    columns = (
        "method",
        "one effect",
        "right",
        "within the ambiguity group",
        "healthy",
        "alarms",
        "not in the catalogue",
        "named",
    )
    return ReportTable("ablations", "Ablations of the method, on the same records", columns, tuple(rows))


def _seen(finished: FinishedCase, key: str) -> bool:
    assert finished.ablation is not None
    rows = finished.ablation.get(key, ())
    return bool(rows) and rows[0]["z"] >= (1.0 if key == "sindy" else finished.ablation["threshold"])


def _first(finished: FinishedCase, key: str) -> tuple[bool, bool]:
    assert finished.ablation is not None
    if not _seen(finished, key):
        return False, False
    row: dict[str, Any] = finished.ablation[key][0]
    said = (row["kind"], row["where"])
    truth = _truth_label(finished.outcome)
    return said == truth, alike(said, truth, ())


def _truth_label(outcome: AnswerScore) -> tuple[str, str]:
    kind, _, rest = outcome.what.partition(" at ")
    return kind, rest.split(" (")[0]


def _by_load(outcomes: Sequence[AnswerScore]) -> ReportTable:
    rows = []
    for load in dict.fromkeys(o.load for o in outcomes):
        one = [o for o in outcomes if o.load == load and o.group == "one"]
        none = [o for o in outcomes if o.load == load and o.group == "none"]
        rows.append(
            (
                load,
                len(one),
                sum(o.alarmed for o in one),
                sum(bool(o.top1) for o in one),
                sum(bool(o.class1) for o in one),
                len(none),
                sum(o.alarmed for o in none),
            )
        )
    columns = ("load", "one effect", "found", "right", "within the ambiguity group", "healthy", "alarms")
    return ReportTable("loads", "By kind of load", columns, tuple(rows))


def failure(o: AnswerScore) -> str | None:
    """Return the error of an answer, None if there is none; an undetectable effect is no failure."""
    if o.verdict == "crashed":
        return "no answer"
    if o.group == "none":
        return "false alarm" if o.alarmed else None
    if o.verdict == "adequate":
        return "missed" if (o.z_truth or 0.0) >= Z_EDGES[2] or o.group == "outside" else None
    if o.group == "outside":
        if o.named:
            return None if o.in_words else "named a cause outside the catalogue"
        return "wrong place" if o.place is False else None
    if o.verdict == "unexplained":
        return "left unexplained"
    if o.group == "two":
        return None if o.exact else "not both" if o.class1 else "wrong"
    if not o.class1:
        return "wrong"
    return "equivalent only" if not o.top1 else "one too many" if not o.exact else None


def _failures(done: Sequence[FinishedCase], size: TrialSize) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for f in done:
        o = f.outcome
        if (what := failure(o)) is not None:
            each = [number(z) for z in (f.ablation or {}).get("z_truth", [])]
            rows.append((o.case, what, o.what, o.load, o.verdict, o.said, o.z, " and ".join(each) or "-", o.confidence))
    columns = ("case", "failure", "truth", "load", "verdict", "answer", "z", "z of the truth", "confidence")
    how = "direct" if size.direct else "wire"
    named = "--case NUMBER, --healthy-case NUMBER or --double-case NUMBER"
    named = named if size.known_healthy else f"--no-healthy {named}"
    again = f"one again: --{how} --hours {size.hours:g} --twin {size.twin} {named}"
    return ReportTable("failures", "Failures", columns, tuple(rows), (again,))
