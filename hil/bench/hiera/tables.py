"""Tables of `hil bench hiera`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from hil.bench.hiera import score as judge
from hil.bench.hiera.score import HieraScore
from hil.bench.measure import Cell, ReportTable

if TYPE_CHECKING:
    from hil.bench.hiera.latency import Latency
    from hil.bench.hiera.trial import HieraResults, Results

BETWEEN = "Middle 90 % when cases are drawn again (bootstrap over cases)."
AHEAD = (
    "Each ten minutes are predicted from earlier data; hiera unet and hiera ls also use their "
    "estimates at the middle, for the second half."
)


def tables(found: HieraResults, rigs: tuple[str, ...]) -> tuple[ReportTable, ...]:
    """Return all tables, in reading order."""
    return (
        errors(found.whole, rigs),
        recovery(found.whole, rigs),
        parameters(found.whole),
        parameter_intervals(found.whole),
        intervals(found.whole, found.calibrating, rigs),
        lost(found),
        false_flags(found),
        cost(found.whole),
        *goals(found),
    )


def _of(results: Results, rig: str) -> dict[str, list[HieraScore]]:
    return {name: [s for s in scores if s.rig == rig] for name, scores in results.items()}


def _range(low: float, high: float, form: str = "{:.3f}") -> Cell:
    return None if not np.isfinite([low, high]).all() else f"{form.format(low)} to {form.format(high)}"


def errors(results: Results, rigs: tuple[str, ...]) -> ReportTable:
    """Return errors of blind predictions, healthy and changed."""
    rows: list[tuple[Cell, ...]] = []
    for rig in rigs:
        for name, scores in _of(results, rig).items():
            if not scores:
                continue
            healthy = judge.interval(scores, lambda x: judge.pooled(x, lambda s: s.before))
            changed = judge.interval(scores, lambda x: judge.pooled(x, lambda s: s.after))
            rows.append(
                (
                    rig,
                    name,
                    healthy[0],
                    _range(*healthy[1:]),
                    judge.typical(scores, lambda s: s.before),
                    changed[0],
                    _range(*changed[1:]),
                    judge.typical(scores, lambda s: s.after),
                )
            )
    return ReportTable(
        "errors",
        "RMSE of predictions ten minutes ahead, K",
        ("rig", "by", "healthy", "from to", "median", "changed", "from to ", "median "),
        tuple(rows),
        (
            AHEAD,
            BETWEEN,
            "Changed: at least one whole window after the change. Against the true readings, where known.",
        ),
    )


def recovery(results: Results, rigs: tuple[str, ...]) -> ReportTable:
    """Return the delay until predictions are right again after a change."""
    rows: list[tuple[Cell, ...]] = []
    for rig in rigs:
        for name, scores in _of(results, rig).items():
            needed = [s.recovered for s in scores if not np.isnan(s.recovered)]
            if not needed:
                continue
            one = judge.interval(scores, lambda x: judge.share_recovered(x, 2.0))
            tracked = [s for s in scores if s.kind == "tracked"]
            count = sum(not np.isnan(s.recovered) for s in tracked)
            rows.append(
                (
                    rig,
                    name,
                    len(needed),
                    _count(float(np.median(needed))),
                    judge.share_recovered(scores, 1.0),
                    one[0],
                    _range(*one[1:], "{:.2f}"),
                    float(np.mean(np.isinf(needed))),
                    count,
                    judge.share_recovered(tracked, 2.0) if count else None,
                )
            )
    return ReportTable(
        "recovery",
        "Targets until predictions are below 0.1 K again, the first whole one after the change being 1",
        ("rig", "by", "changes", "median", "at 1", "by 2", "from to", "never", "tracked", "by 2 "),
        tuple(rows),
        (
            "By 2: after one whole window of the changed rig. Only changes that put the commissioned twin above 0.1 K "
            "count.",
            "Tracked: changes of a parameter that the twin tracks. The others are heat or physics that it lacks, and "
            "biased sensors, whose true reading is the target.",
            BETWEEN,
        ),
    )


def _count(value: float) -> Cell:
    return "never" if np.isinf(value) else value


def _sound(scores: list[HieraScore]) -> list[HieraScore]:
    """Return cases of rigs without physics that the twin lacks: elsewhere no value of its parameters is right."""
    return [s for s in scores if s.kind in ("healthy", "tracked")]


def parameters(results: Results) -> ReportTable:
    """Return errors of deviations over their Cramer-Rao bounds."""
    rows: list[tuple[Cell, ...]] = []
    for rig in ("simulated", "virtual"):
        for name, scores in _of(results, rig).items():
            told = [s for s in scores if np.isfinite(s.off).any()]
            if not told or name == "commissioned":
                continue
            value, low, high = judge.interval(told, judge.median_over_bound)
            count = int(sum(np.isfinite(s.off).sum() for s in told))
            figures = (
                judge.over_bound(told),
                judge.over_bound(told, accepted=True),
                judge.over_bound(told, accepted=True, told=True),
                judge.over_bound(_sound(told), accepted=True),
            )
            rows.append((rig, name, count, value, _range(low, high, "{:.2f}"), *figures))
    return ReportTable(
        "parameters",
        "Parameter errors over their Cramer-Rao bounds, where the data tells them",
        ("rig", "by", "numbers", "median", "from to", "RMS", "accepted", "not held", "as the twin"),
        tuple(rows),
        (
            "Accepted: RMS over windows before which the contestant said that it was calibrated; not held: the same of "
            "parameters that it gave an interval; as the twin: accepted ones of rigs that have no physics but the "
            "twin's, healthy ones and those with a tracked parameter changed.",
            "0.67 is the median of an efficient estimate, 1 its RMS. The bound counts noise and an error of 0.02 K "
            "that lasts a minute; a rig that is not its twin is off by more, whoever looks.",
            BETWEEN,
        ),
    )


def parameter_intervals(results: Results) -> ReportTable:
    """Return the coverage of parameters by the intervals of their calibrators."""
    rows: list[tuple[Cell, ...]] = []
    for rig in ("simulated", "virtual"):
        for name, scores in _of(results, rig).items():
            told = [s for s in scores if np.isfinite(s.sure).any()]
            if not told:
                continue
            healthy = judge.interval(told, lambda x: judge.sure(x, lambda one: one.before))
            changed = judge.interval(told, lambda x: judge.sure(x, lambda one: one.after))
            rows.append(
                (
                    rig,
                    name,
                    int(sum(np.isfinite(s.sure[s.before | s.after]).sum() for s in told)),
                    healthy[0],
                    _range(*healthy[1:], "{:.2f}"),
                    changed[0],
                    _range(*changed[1:], "{:.2f}"),
                )
            )
    return ReportTable(
        "parameter_intervals",
        "Parameters inside their own 90 % intervals",
        ("rig", "by", "numbers", "healthy", "from to", "changed", "from to "),
        tuple(rows),
        ("Where data and calibrator tell them: what is held has no interval.", BETWEEN),
    )


def intervals(results: Results, calibrating: Results, rigs: tuple[str, ...]) -> ReportTable:
    """Return coverage and width of 90 % intervals."""
    rows: list[tuple[Cell, ...]] = []
    for rig in rigs:
        for name, scores in _of(results, rig).items():
            if not scores:
                continue
            widths = judge.constant_widths(calibrating[name], 0)
            value, low, high = judge.interval(scores, _share(widths))
            rows.append((rig, name, "constant", value, _range(low, high, "{:.2f}"), judge.coverage(scores, widths)[1]))
            if any(s.half is not None for s in scores):
                factors = judge.own_factors(calibrating[name], 0)
                value, low, high = judge.interval(scores, _share(factors, own=True))
                width = judge.coverage(scores, factors, own=True)[1]
                rows.append((rig, name, "its own", value, _range(low, high, "{:.2f}"), width))
    return ReportTable(
        "intervals",
        "Intervals that promise 90 %",
        ("rig", "by", "width is", "inside", "from to", "mean width K"),
        tuple(rows),
        (
            "Constant: split conformal, one half width a sensor, from other rigs of both kinds. "
            "Its own: the predicted width times a factor found on the same.",
            BETWEEN,
        ),
    )


def _share(widths: np.ndarray, *, own: bool = False) -> Callable[[list[HieraScore]], float]:
    """Return the share inside of a list of scores; each is counted once, also in a bootstrap."""
    counted: dict[int, tuple[float, float, int]] = {}

    def share(scores: list[HieraScore]) -> float:
        for s in scores:
            if id(s) not in counted:
                counted[id(s)] = judge.tally(s, widths, own=own)
        known = sum(counted[id(s)][2] for s in scores)
        return sum(counted[id(s)][0] for s in scores) / known if known else float("nan")

    return share


def lost(found: HieraResults) -> ReportTable:
    """Return errors with channels hidden."""
    rows: list[tuple[Cell, ...]] = []
    shares = sorted(found.lost)
    for rig in ("simulated", "virtual"):
        for name, whole in _of(found.lost[0.0], rig).items():
            if not whole:
                continue
            row: list[Cell] = [rig, name]
            for share in shares:
                fewer = _of(found.lost[share], rig)[name]
                row += [judge.pooled(fewer, _all), judge.typical(fewer, _all)]
            rows.append(tuple(row))
    columns: list[str] = ["rig", "by"]
    for share in shares:
        columns += ["RMSE", "median"] if share == 0.0 else [f"RMSE -{share:.0%}", f"median -{share:.0%}"]
    count = max((len(scores) for scores in found.lost[0.0].values()), default=0)
    notes = (f"Sensors and inputs alike, from half an hour on, in {count} cases. A lost input holds its last value.",)
    return ReportTable("lost", "With a share of the channels lost, K", tuple(columns), tuple(rows), notes)


def _all(s: HieraScore) -> np.ndarray:
    return np.ones(len(s.rmse), dtype=bool)


def false_flags(found: HieraResults) -> ReportTable:
    """Return the share of false `calibrated` flags."""
    rows: list[tuple[Cell, ...]] = []
    for name, scores in found.whole.items():
        said = np.concatenate([s.calibrated for s in scores])
        if not said.any():
            continue
        value, low, high = judge.interval(scores, lambda x: judge.falsely_calibrated(x, found.threshold_K))
        rows.append((name, float(said.mean()), value, _range(low, high, "{:.2f}")))
    return ReportTable(
        "flags",
        f"Said to be calibrated, and the next ten minutes missed by more than {found.threshold_K:g} K",
        ("by", "said", "false", "from to"),
        tuple(rows),
        (BETWEEN,),
    )


RIVALS = {
    "network": "fit of 2 h",
    "network, fit": "fit of 2 h",
    "hiera unet": "least squares",
    "hiera ls": "least squares",
}
"""Rival that a contestant must not be worse than: the same fit without the network."""


def goals(found: HieraResults) -> tuple[ReportTable, ...]:
    """Return the network's goals and results; no table without a network."""
    rows: list[tuple[Cell, ...]] = []
    for name in (n for n in RIVALS if n in found.whole):
        scores = [s for s in found.whole[name] if s.rig != "stranger"]
        own = any(s.half is not None for s in scores)
        calibrating = found.calibrating[name]
        widths = judge.own_factors(calibrating, 0) if own else judge.constant_widths(calibrating, 0)
        told = [s for s in scores if np.isfinite(s.off).any()]
        moved = [s for s in scores if s.kind == "tracked"]
        rival = found.whole.get(RIVALS[name])
        simulated = [
            (name, "90 % intervals hold", "0.88 to 0.92", judge.coverage(scores, widths, own=own)[0]),
            (name, "parameter error over bound, median / 0.67", "<= 1.5", judge.median_over_bound(told) / 0.6745),
            (name, "the same of accepted windows, RMS", "<= 1.5", judge.over_bound(told, accepted=True)),
            (
                name,
                "the same of rigs with no physics but the twin's",
                "<= 1.5",
                judge.over_bound(_sound(told), accepted=True),
            ),
            (name, "changes of tracked parameters recovered by 2", ">= 0.95", judge.share_recovered(moved, 2.0)),
        ]
        rows += simulated if scores else []  # Neither truth nor bound of a stranger's rig is known.
        rows.append((name, "changes recovered by 2", ">= 0.95", judge.share_recovered(found.whole[name], 2.0)))
        if rival is not None:
            rows.append(
                (name, f"changes in which worse than {RIVALS[name]}", "0", judge.worse(found.whole[name], rival))
            )
    if not rows:
        return ()
    notes = (f"Worse: RMSE after the change larger by more than {judge.WORSE - 1.0:.0%} and by {judge.WORSE_K:g} K.",)
    return (ReportTable("goals", "Against the goals", ("by", "what", "goal", "found"), tuple(rows), notes),)


def cost(results: Results) -> ReportTable:
    """Return the CPU time of one window."""
    rows = tuple((name, 1e3 * float(np.median([s.cpu_s for s in scores]))) for name, scores in results.items())
    return ReportTable("cost", "CPU time, ms a window of ten minutes (one thread)", ("by", "ms"), rows)


LIMITS_MS = {"small": 10.0, "full": 50.0}
"""Longest time of one causal forward pass, ms."""


def forwards(timed: Iterable[Latency]) -> tuple[ReportTable, ...]:
    """Return the time of one causal forward pass of each configuration, on one thread."""
    rows = tuple((t.config, t.weights, t.minimum_ms, t.median_ms, LIMITS_MS[t.config]) for t in timed)
    notes = ("Of random weights; the least of many says what it costs where nothing else runs.",)
    columns = ("configuration", "weights", "least", "median", "goal <=")
    return (ReportTable("forwards", "One causal forward, ms (one thread)", columns, rows, notes),)
