"""Trial of the network of effects and of its linear rival on plants that no training saw, and its tables."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.bench.discovery import wilson
from hil.bench.effects.judge import FALSE_A_DAY, VISIBLE, Case, Outcome, judged, share, threshold_for, visible
from hil.bench.effects.simulated import UNSEEN, make_records, make_rig
from hil.bench.effects.store import SPLITS, Split, StoredRig, effects_of, planned, read
from hil.bench.effects.training import cases_of
from hil.bench.measure import Cell, ReportTable, median
from hil.bench.zoo.plants import START_H
from hil.diagnosis import columns_of, with_clock
from hil.record import Record
from twin.calibrators.hiera_unet.effects.balance import EVERY_S
from twin.calibrators.hiera_unet.effects.courses import linear_course
from twin.calibrators.hiera_unet.effects.member import EffectsMember
from twin.calibrators.hiera_unet.effects.scores import window_scores
from twin.calibrators.hiera_unet.effects.watch import EffectsWatch, one_thread
from twin.discovery import diagnose

GOAL = 80.0
"""Share of visible cases whose place is to be found within two windows, %."""
LINEAR, NETWORK = "largest window score", "network"
BANDS = (0.0, 3.0, 10.0, 30.0, 100.0, math.inf)


@dataclass(frozen=True)
class Judged:
    """Outcomes of a method on one split, with its threshold, false alarms and healthy days."""

    method: str
    split: str
    threshold: float
    outcomes: list[Outcome]
    false: int
    days: float


def linear_cases(rigs: Iterator[StoredRig]) -> list[Case]:
    """Return the cases of rigs as the largest window score judges them."""
    found = []
    for rig in rigs:
        memory = rig.memory()
        for record in rig.records:
            course, calm = (linear_course(window_scores(f, memory)) for f in (record.figures, record.calm))
            found.append(Case(course, calm, rig.hypotheses, record))
    return found


def judge_all(folder: Path, member: EffectsMember | None, say: Callable[[str], None] = lambda _: None) -> list[Judged]:
    """Judge both methods on both test splits; the rival's threshold is set on the same records as the network's."""
    say("linear rival: threshold")
    calm = [(c.calm, c.record.calm.end_s) for c in linear_cases(read(folder, SPLITS[1]))]
    limit = threshold_for(calm)
    found = []
    for split in SPLITS[2:]:
        say(f"{split.name}: linear rival")
        found.append(Judged(LINEAR, split.name, limit, *judged(linear_cases(read(folder, split)), limit)))
        if member is not None:
            say(f"{split.name}: network")
            cases = cases_of(member, read(folder, split))
            found.append(Judged(NETWORK, split.name, member.threshold, *judged(cases, member.threshold)))
    return found


def tables(done: Sequence[Judged]) -> tuple[ReportTable, ...]:
    """Return the tables of a trial."""
    both = pooled(done)
    return (
        _goal(both),
        _found(done, both),
        _false(done, both),
        _by("early", "By the true score of the first two windows", both, _band),
        _by("group", "Visible cases by group of effects", both, lambda o: str(o.truth["group"]), VISIBLE),
        _by("family", "Visible cases by family", both, lambda o: str(o.truth["family"]), VISIBLE),
        _errors(both),
    )


def pooled(done: Sequence[Judged]) -> list[Judged]:
    """Return both test splits of each method together."""
    found = []
    for method in dict.fromkeys(j.method for j in done):
        mine = [j for j in done if j.method == method]
        outcomes = [o for j in mine for o in j.outcomes]
        found.append(
            Judged(method, "all", mine[0].threshold, outcomes, sum(j.false for j in mine), sum(j.days for j in mine))
        )
    return found


def reached(one: Judged) -> bool:
    """Return True if a method reaches the goal: place and false alarms."""
    part = share(visible(one.outcomes), lambda o: o.found) or 0.0
    return part >= GOAL and one.false <= FALSE_A_DAY * one.days


def _goal(both: Sequence[Judged]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for one in both:
        seen = visible(one.outcomes)
        rows.append(
            (
                one.method,
                share(seen, lambda o: o.found),
                100.0 * one.false / one.days,
                "reached" if reached(one) else "not reached",
            )
        )
    driven = any(reached(one) for one in both if one.method == NETWORK)
    note = "the network may drive the live warning" if driven else "the live warning of a run stays as it is"
    return ReportTable(
        "goal",
        "Goal: place within two windows in 80 % of visible cases, false alarms on at most 1 % of days",
        ("method", "place found, %", "false alarms, % of days", "goal"),
        tuple(rows),
        (note, f"visible: true score of the first two windows (20 min) of {VISIBLE:g} or more"),
    )


def _found(done: Sequence[Judged], both: Sequence[Judged]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for one in (*both, *done):
        seen = visible(one.outcomes)
        hits = sum(o.found for o in seen)
        low, high = wilson(hits, len(seen))
        timely = [o for o in seen if o.intime]
        delays = [o.delay_s / 60.0 for o in seen if o.delay_s is not None]
        rows.append(
            (
                f"{one.method}, {_PLANTS[one.split]}",
                len(seen),
                100.0 * hits / len(seen) if seen else None,
                100.0 * low,
                100.0 * high,
                share(seen, lambda o: o.intime),
                share(timely, lambda o: o.right_place),
                share(timely, lambda o: o.right_kind),
                share(timely, lambda o: o.right_at_once),
                median(delays),
            )
        )
    columns = (
        "method, plants",
        "visible",
        "place found, %",
        "90 % from",
        "to",
        "warned in time, %",
        "of these place, %",
        "kind and place, %",
        "place at the first warning, %",
        "delay, min",
    )
    return ReportTable(
        "found",
        "Found within two windows",
        columns,
        tuple(rows),
        ("place: of the answer at the end of the second window; delay: median of all warnings",),
    )


_PLANTS = {
    "all": "all",
    "test_seen": "families of the training",
    "test_unseen": f"unseen families ({', '.join(UNSEEN)})",
}


def _false(done: Sequence[Judged], both: Sequence[Judged]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for one in (*both, *done):
        low, high = poisson_interval(one.false)
        rows.append(
            (
                f"{one.method}, {_PLANTS[one.split]}",
                one.false,
                one.days,
                100.0 * one.false / one.days,
                100.0 * low / one.days,
                100.0 * high / one.days,
                sum(o.early for o in one.outcomes),
                one.threshold,
            )
        )
    columns = (
        "method, plants",
        "alarms",
        "healthy days",
        "% a day",
        "90 % from",
        "to",
        "records warned before the onset",
        "threshold",
    )
    note = "thresholds: least with at most 1 % false alarms a day on calibration plants, which no test has"
    return ReportTable("false", "False alarms on healthy records", columns, tuple(rows), (note,))


def poisson_interval(count: int) -> tuple[float, float]:
    """Return the 90 % interval of a Poisson mean from one count (Garwood, Biometrika 28 (1936) 437)."""
    from scipy.stats import chi2

    return (float(chi2.ppf(0.05, 2 * count) / 2.0) if count else 0.0, float(chi2.ppf(0.95, 2 * count + 2) / 2.0))


def _band(o: Outcome) -> str:
    score = float(o.truth["early"][0])
    for low, high in zip(BANDS[:-1], BANDS[1:], strict=True):
        if low <= score < high:
            return f"{low:g} to {high:g}" if high < math.inf else f"above {low:g}"
    return "none: it never acts"


def _by(
    key: str, title: str, both: Sequence[Judged], of: Callable[[Outcome], str], least: float = -math.inf
) -> ReportTable:
    chosen = {j.method: visible(j.outcomes, least) if least > -math.inf else j.outcomes for j in both}
    names = sorted({of(o) for outcomes in chosen.values() for o in outcomes}, key=_order)
    rows: list[tuple[Cell, ...]] = []
    for name in names:
        row: list[Cell] = [name]
        for method, outcomes in chosen.items():
            mine = [o for o in outcomes if of(o) == name]
            if method == both[0].method:
                row.append(len(mine))
            row += [share(mine, lambda o: o.found), share(mine, lambda o: o.intime)]
        rows.append(tuple(row))
    columns = (key, "cases", *(f"{m}: {what}, %" for m in chosen for what in ("place found", "warned")))
    return ReportTable(key, title, columns, tuple(rows))


def _order(name: str) -> tuple[float, str]:
    word = name.removeprefix("above ").split(" ")[0]
    return (float(word), name) if word.replace(".", "").isdigit() else (math.inf, name)


def _errors(both: Sequence[Judged]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for one in both:
        warned = [o for o in one.outcomes if o.delay_s is not None and o.right_place]
        sized = [o for o in warned if math.isfinite(o.size_error)]
        rows.append(
            (
                one.method,
                len(warned),
                median([abs(o.since_error_s) / 60.0 for o in warned]),
                share(warned, lambda o: o.since_inside),
                len(sized),
                median([100.0 * abs(o.size_error) for o in sized]),
                share(sized, lambda o: o.size_inside),
            )
        )
    columns = (
        "method",
        "right warnings",
        "onset error, min",
        "in its 90 % interval, %",
        "with a size",
        "size error, %",
        "in its 90 % interval, %",
    )
    return ReportTable(
        "errors",
        "Onset and size at the first warning that names the place",
        columns,
        tuple(rows),
        ("medians; size: heat in W and readings in K, against the true course of that window",),
    )


def further_tables(
    folder: Path, seed: int, member: EffectsMember, diagnosed: int, say: Callable[[str], None] = lambda _: None
) -> tuple[ReportTable, ...]:
    """Return the tables of latency and of agreement with the diagnosis.

    Parameters
    ----------
    folder, seed
        Folder of simulated rigs, and their seed.
    member
        The network.
    diagnosed
        Number of visible records that the diagnosis judges too; 0 for none.
    say
        Function that gets what is under way.
    """
    found = [_latency(seed, member)]
    if diagnosed:
        found.append(_agreement(folder, seed, member, diagnosed, say))
    return tuple(found)


def _latency(seed: int, member: EffectsMember) -> ReportTable:
    """Return the time from the samples of a window to its answer, on one thread, for all windows of a record."""
    rig = make_rig(*planned(SPLITS[2], seed)[0])
    kept: list[Record] = []
    make_records(rig, 1, kept=kept)
    (record,) = kept
    inputs, measured = rig.network.select(record.columns)
    rows: list[tuple[Cell, ...]] = []
    with one_thread():
        watch = EffectsWatch(rig.network, rig.usually, member)
        took = []
        for begin in np.arange(0.0, record.time_s[-1], EVERY_S):
            new = (record.time_s >= begin) & (record.time_s < begin + EVERY_S)
            began = time.perf_counter()
            answered = watch.push(record.time_s[new], inputs[new], measured[new])
            took += [1e3 * (time.perf_counter() - began)] if answered else []
    rows.append((len(rig.balance.hypotheses), len(record.time_s), len(took), median(took), float(np.max(took))))
    columns = ("hypotheses", "samples of the record", "answers", "ms", "longest, ms")
    return ReportTable(
        "latency", "Latency of one look on one thread", columns, tuple(rows), (f"{member.network.count()} weights",)
    )


def _agreement(folder: Path, seed: int, member: EffectsMember, count: int, say: Callable[[str], None]) -> ReportTable:
    """Return the answers of network and diagnosis on visible records, from the whole record."""
    rows: list[tuple[Cell, ...]] = []
    for split in SPLITS[2:]:
        for k, stored in enumerate(read(folder, split)):
            if len(rows) >= count * (SPLITS.index(split) - 1) // 2:
                break
            one = _compared(split, seed, k, stored, member)
            rows += [one] if one else []
            say(f"diagnosed {len(rows)} of {count}")
    columns = ("plant", "truth", "accepted", "network", "diagnosis", "verdict", "same place")
    same = sum(row[-1] == "yes" for row in rows)
    return ReportTable(
        "agreement", "Agreement with the diagnosis", columns, tuple(rows), (f"{same} of {len(rows)} agree",)
    )


def _compared(split: Split, seed: int, k: int, stored: StoredRig, member: EffectsMember) -> tuple[Cell, ...] | None:
    """Return the row of the rig's first visible record; None without one."""
    memory = stored.memory()
    index = next((j for j, r in enumerate(stored.records) if float(r.truth["early"][0]) >= VISIBLE), None)
    if index is None:
        return None
    case = stored.records[index]
    course = member.course(window_scores(case.figures, memory), stored.hypotheses)
    last = int(np.argmax(course.statistic))
    warned = bool(course.statistic[last] > member.threshold)
    named = stored.hypotheses[int(course.hypothesis[last])]
    rig = make_rig(*planned(split, seed)[k])
    kept: list[Record] = []
    make_records(rig, index + 1, effects_of(split, seed, k), kept=kept)
    clocked = with_clock(rig.network)
    answer = diagnose(clocked, columns_of(clocked, kept[index], START_H), columns_of(clocked, rig.healthy, START_H))
    place = answer.effects[0].where if answer.effects else "-"
    return (
        f"{split.name} {k}, {case.truth['family']}",
        str(case.truth["effect"]),
        ", ".join(case.truth["places"]),
        f"{named.named} at {named.where}" if warned else "no warning",
        f"{answer.effects[0].kind} at {place}" if answer.effects else "-",
        answer.verdict,
        "yes" if warned and place == named.where else "no",
    )
