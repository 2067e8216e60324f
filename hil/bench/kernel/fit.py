"""Benchmark `hil bench fit`: quality, reliability and CPU time of fits of a ten-minute window."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hil.bench.kernel.problems import Problem, box, made_up, measured
from hil.bench.kernel.whole_record import whole_table
from hil.bench.measure import Cell, ReportTable, median
from hil.bench.peers import Absent, filter_peer, optimisers
from hil.run.session import ProgressBar
from twin import Array, Network, load, mask_measurements
from twin.calibrators import UNTRAINED_CALIBRATORS, make_calibrator
from twin.gauss_newton import FitData, GaussianPrior, Scaling
from twin.gauss_newton import FitProblem as GaussNewton

TWINS = Path(__file__).resolve().parents[3] / "profiles" / "twins"
AT_OPTIMUM = 5e-4
"""Relative distance from the best known RMSE within which a fit counts as optimal."""
DESCENT = "ours: Gauss-Newton alone"
NO_PRIOR = 1e-10
"""Precision of the descent's prior as a share of the calibrators': enough to keep its equations regular."""
MOST, TOLERANCE = 100, 1.0e-6
"""Most linearisations of the descent, and the relative decrease at which it ends."""
SETS = ("paper4", "nine", "twelve")

Peer = Callable[[Problem, int], Array]
PEERS: tuple[tuple[str, Peer], ...] = (
    ("pyswarms 200 x 50", optimisers.pyswarms_global),
    ("pymoo PSO 200 x 50", optimisers.pymoo_pso),
    ("cma", optimisers.cma_es),
    ("scipy differential_evolution", optimisers.differential_evolution),
    ("scipy least_squares", optimisers.least_squares),
    ("scipy least_squares, lanes", optimisers.least_squares_lanes),
    ("filterpy joint UKF, one pass", filter_peer.joint_ukf),
)


@dataclass(frozen=True, slots=True)
class FitSize:
    """Size of the benchmark: windows, samples of each, sets of tunables; hours of the tracked record."""

    windows: int = 20
    samples: int = 600
    sets: tuple[str, ...] = SETS
    whole_h: float = 40.0


FULL = FitSize()
QUICK = FitSize(windows=3, sets=("paper4", "nine"), whole_h=2.0)


@dataclass(slots=True)
class _MethodScore:
    """Results of one method over the windows: RMSE in K, ratio to the best known, simulations, CPU ms."""

    rmse: list[float] = field(default_factory=list)
    ratio: list[float] = field(default_factory=list)
    evaluations: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)
    free_state: bool = False


@dataclass(frozen=True, slots=True)
class MeasuredRecord:
    """Measured record to cut windows from, and the twin that is fitted to them."""

    path: Path
    twin: Network


def measure(
    size: FitSize, seed: int, record: MeasuredRecord | None = None
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return a table for each set of tunables (and one of measured windows), and one of a whole record."""
    network = load(TWINS / "loop.toml")
    absent: dict[str, None] = {}
    groups: list[tuple[str, str, list[Problem]]] = []
    for name in size.sets:
        problems = made_up(network, name, size.windows, seed, size.samples)
        groups.append((name, f"{len(problems)} made-up windows, {len(problems[0].ids)} tunables ({name})", problems))
    if record is not None:
        cut = measured(record.twin, "nine", record.path, size.windows)
        groups.append(("measured", f"{len(cut)} windows of {record.path.name}, {len(cut[0].ids)} tunables", cut))
    tables = []
    with ProgressBar("fitting", sum(len(problems) for _, _, problems in groups)) as bar:
        done = 0
        for key, title, problems in groups:
            scores: dict[str, _MethodScore] = {}
            for number, problem in enumerate(problems):
                bar.update(done, title)
                _one_window(problem, seed + number, scores, absent)
                done += 1
            tables.append(_table(key, title, scores))
    tables.append(whole_table(network, size.whole_h, seed))
    tables.append(_goals(tables, full=size.whole_h == FULL.whole_h))
    return tuple(tables), tuple(absent)


def _one_window(problem: Problem, seed: int, scores: dict[str, _MethodScore], absent: dict[str, None]) -> None:
    """Fit one window with every method; then compare all with the best fit of any method."""
    found: dict[str, tuple[float, bool]] = {}
    for name in UNTRAINED_CALIBRATORS:
        # The first call loads the calibrator's machine code; the clock runs for a new calibrator with loaded code.
        calibrator = make_calibrator(name, problem.network, problem.tunables, seed)
        fresh = calibrator.state()
        calibrator.calibrate(problem.window)
        calibrator.restore(fresh)
        began = time.process_time()
        calibration = calibrator.calibrate(problem.window)
        took = time.process_time() - began
        full = problem.window.parameters.copy()
        full[problem.network.index(problem.ids)] = [calibration.values[i] for i in problem.ids]
        readings, _ = problem.kernel.trace(full, calibration.state, problem.window.time, problem.window.inputs)
        residual = readings[0] - problem.window.measured
        rmse = float(np.sqrt(np.nanmean(residual**2)))
        free = not np.array_equal(calibration.state, problem.window.state)
        found[f"ours: {name}"] = (rmse, free)
        _note(scores, f"ours: {name}", rmse, calibration.evaluations, took, free)
    _descent(problem, seed)  # This call loads the machine code, too.
    for name, peer in ((DESCENT, _descent), *PEERS):
        problem.evaluations = 0
        began = time.process_time()
        try:
            positions = peer(problem, seed)
        except Absent as why:
            absent[str(why)] = None
            continue
        took = time.process_time() - began
        evaluations = problem.evaluations
        rmse = float(problem.rmse(positions)[0]) if np.isfinite(positions).all() else float("inf")
        found[name] = (rmse, False)
        _note(scores, name, rmse, evaluations, took, False)
    best = _best_known(problem, found)
    for name, (rmse, free) in found.items():
        scores[name].ratio.append(rmse / best[free])


def _descent(problem: Problem, seed: int) -> Array:
    """Return positions (q,) by the calibrators' own Gauss-Newton on the window alone: state given, no prior, nothing
    held.

    One start, the live twin's values. What `least_squares` stays above this is what its prior and its holding cost.
    """
    window, network = problem.window, problem.network
    low, high = box(network, problem.ids)
    scaling = replace(Scaling.of(network, problem.ids), lower=low, upper=high)
    data = FitData(window.time, window.inputs, *mask_measurements(window.measured, network.sigma))
    descent = GaussNewton(problem.kernel, scaling, window.parameters, data, window.state)
    k = len(network.nodes)
    v = np.concatenate([scaling.to_z(problem.values(problem.start)), window.state[:k]])
    flat = GaussianPrior(v, np.diag(np.concatenate([NO_PRIOR * scaling.prior_sd() ** -2, np.ones(k)])))
    state_given = np.arange(v.size) >= len(problem.ids)
    fit = descent.minimise(v, flat, held=state_given, most=MOST, tolerance=TOLERANCE)
    problem.evaluations = fit.evaluations * (1 + v.size)
    return problem.positions(fit.values)


def _note(scores: dict[str, _MethodScore], name: str, rmse: float, evaluations: int, took: float, free: bool) -> None:
    score = scores.setdefault(name, _MethodScore())
    score.rmse.append(rmse)
    score.evaluations.append(float(evaluations))
    score.cpu_ms.append(1e3 * took)
    score.free_state = score.free_state or free


def _best_known(problem: Problem, found: dict[str, tuple[float, bool]]) -> dict[bool, float]:
    """Return the least known RMSE with the initial state given (False) and free (True): all methods, and TRF from three
    starts.
    """
    starts = [problem.start, np.full_like(problem.start, 0.5)]
    starts += [] if problem.truth is None else [problem.truth]
    best = {False: np.inf, True: np.inf}
    q = len(problem.start)
    for start in starts:
        for free in (False, True):
            x = optimisers.refine(problem, start, state=free)
            at = problem.window.state + x[q:] if free else None
            best[free] = min(best[free], float(problem.rmse(x[:q], at)[0]))
    for rmse, free in found.values():
        best[free] = min(best[free], rmse)
    return best


def _table(key: str, title: str, scores: dict[str, _MethodScore]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for name, score in scores.items():
        there = 100.0 * float(np.mean([r <= 1.0 + AT_OPTIMUM for r in score.ratio]))
        rows.append(
            (
                name + (" *" if score.free_state else ""),
                median(score.rmse),
                100.0 * (median(score.ratio) - 1.0),
                100.0 * (max(score.ratio) - 1.0),
                f"{there:.0f} %",
                median(score.evaluations),
                median(score.cpu_ms),
            )
        )
    columns = ("method", "RMSE K", "above best %", "worst %", "at optimum", "simulations", "CPU ms")
    notes = (
        f"Medians; at optimum: within {AT_OPTIMUM:.2%} of the least RMSE that anyone, or TRF from three starts, found.",
        "* estimates the initial state too, and is measured against the best with a free state. "
        "Everyone simulates with our kernel; the filter with its own steps. lanes: with a Jacobian out of one "
        "call of the kernel.",
        f"{DESCENT.removeprefix('ours: ')}: the calibrators' descent with neither their prior nor their holding of "
        "parameters that the window does not identify; the excess of least_squares over its best is the cost of both.",
    )
    return ReportTable(key, title, columns, tuple(rows), notes)


def _goals(tables: list[ReportTable], *, full: bool) -> ReportTable:
    """Compare our calibrator, and its descent alone, with the goals."""
    by_key = {table.key: table for table in tables}
    rows: list[tuple[Cell, ...]] = []
    for key, most_ms in (("paper4", 2.0), ("twelve", 3.0)):
        if key in by_key:
            count = by_key[key].title.split(", ")[1]
            for row in by_key[key].rows:
                name = str(row[0]).removesuffix(" *")
                if name in (DESCENT, "ours: least_squares"):
                    rows.append((f"{name}, {count}: CPU ms a window", row[6], f"<= {most_ms:g}"))
                    rows.append((f"{name}, {count}: windows at the optimum", row[4], ">= 99 %"))
    if full:
        for tunables, most_s in (("4", 0.3), ("12", 1.0)):
            here = [row for row in by_key["whole"].rows if row[1] == tunables]
            ours = min(here, key=lambda row: float(row[3] or 0.0))
            rows.append((f"{ours[0]}, {tunables} tunables: CPU s for 240 windows", ours[3], f"<= {most_s:g}"))
    return ReportTable("goals", "Against the goals", ("what", "measured", "goal"), tuple(rows))
