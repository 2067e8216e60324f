"""Benchmark `hil bench twin`: cost of one window, ours and that of peers, and the distance to the goals."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.bench.kernel import contestants, footprint
from hil.bench.kernel.contestants import Single, Swarm, oracle
from hil.bench.kernel.windows import Job, corners, job
from hil.bench.measure import Cell, ReportTable, cpu_s, number
from hil.bench.peers import Absent
from hil.bench.peers.formulas import sensor_rows
from hil.run.session import ProgressBar
from twin import Array, Network, load, simulate_fine_steps

TWINS = Path(__file__).resolve().parents[3] / "profiles" / "twins"
MATCHED_K = 1e-6
"""Largest error of a solver of matched accuracy, K."""
FINE = 200
"""Steps a second of the slow simulation that judges networks with pipes."""
JUDGED = 20
"""Particles of a swarm whose cost is compared with the exact one."""


@dataclass(frozen=True, slots=True)
class SpeedSize:
    """Size of the benchmark. `samples` of one second make a window; `whole_h` is the long forward run."""

    samples: int = 600
    counts: tuple[int, ...] = (1, 100, 1_000, 10_000, 100_000)
    schedules: tuple[str, ...] = contestants.ALL
    whole_h: float = 40.0
    memory_count: int = 100_000
    slow: bool = True
    processes: bool = True
    budget_s: float = 1.5


FULL = SpeedSize()
QUICK = SpeedSize(counts=(1, 100, 1_000), schedules=("each s",), whole_h=4.0, slow=False, budget_s=0.3)


@dataclass(slots=True)
class _Measured:
    """Figures by contestant and schedule, and lines about what is missing."""

    single: dict[str, dict[str, tuple[float, float]]]
    swarm: dict[tuple[str, str], dict[int, float]]
    cost_error: dict[tuple[str, str], float]
    absent: dict[str, None]
    worst: dict[str, float]


def measure(size: SpeedSize, seed: int) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return all tables, and a line for every absent contestant."""
    network = load(TWINS / "loop.toml")
    found = _Measured({}, {}, {}, {}, {})
    extra = _other_networks(found)
    steps: list[tuple[str, Callable[[], None]]] = []
    for schedule in size.schedules:
        window = job(network, schedule, count=max(size.counts), samples=size.samples, seed=seed)
        exact = oracle(window)[:, sensor_rows(network)]
        steps += _single_steps(window, exact, size, found)
        costs = _exact_costs(window)
        for peer in contestants.swarms():
            if schedule in peer.schedules:
                for count in (c for c in size.counts if c <= peer.most):
                    steps.append((peer.name, _swarm_step(peer, window, count, costs, size, found)))
    for name, other in extra:
        window = job(other, "each s", count=max(size.counts), samples=size.samples, seed=seed)
        mine = Swarm(name, contestants.ours, 10_000)
        for count in (c for c in size.counts if c <= mine.most):
            steps.append((name, _swarm_step(mine, window, count, None, size, found)))
        steps.append((name, _own_error_step(name, window, found)))
    whole: list[tuple[Cell, ...]] = []
    steps += footprint.whole_steps(network, size, seed, whole)
    facts: dict[str, float] = {}
    if size.processes:
        steps += footprint.process_steps(size.memory_count, facts)
    with ProgressBar("measuring", len(steps)) as bar:
        for done, (name, step) in enumerate(steps):
            bar.update(done, name)
            try:
                step()
            except Absent as why:
                found.absent[str(why)] = None
            except RuntimeError as why:
                found.absent[f"{name}: {why}"] = None
    tables = (
        _single_table(found, size),
        _swarm_table(found, size),
        footprint.whole_table(whole, size.whole_h),
        _goal_table(found, size, whole, facts),
    )
    return tables, tuple(found.absent)


def _other_networks(found: _Measured) -> list[tuple[str, Network]]:
    """Measure other networks than the four-volume loop that this version can simulate: a nonlinear one, one of more
    volumes.
    """
    from hil.bench.kernel.variants import nine_volumes, nonlinear

    out = []
    for label, make in (("ours, radiation", nonlinear), ("ours, six modules", nine_volumes)):
        try:
            network = make()
        except Absent as why:
            found.absent[str(why)] = None
            continue
        out.append((label, network))
    return out


def _single_steps(
    window: Job, exact: Array, size: SpeedSize, found: _Measured
) -> Iterable[tuple[str, Callable[[], None]]]:
    reads, one = sensor_rows(window.network), window.of(1)

    def mine() -> None:
        took = cpu_s(contestants.ours(one), budget_s=size.budget_s)
        error = float(np.abs(contestants.our_readings(one)() - exact).max())
        found.single.setdefault("ours, one vector", {})[window.schedule] = (took, error)
        found.worst["swarm"] = max(found.worst.get("swarm", 0.0), contestants.our_error(window.of(JUDGED)))
        found.worst["corners"] = max(found.worst.get("corners", 0.0), contestants.our_error(corners(window)))

    def other(peer: Single) -> Callable[[], None]:
        def step() -> None:
            call = peer.prepare(one)
            error = float(np.abs(call()[:, reads] - exact).max())
            took = cpu_s(call, budget_s=size.budget_s, warm=False)
            found.single.setdefault(peer.name, {})[window.schedule] = (took, error)

        return step

    yield "ours, one vector", mine
    for peer in contestants.singles():
        if window.schedule in peer.schedules and (size.slow or not peer.slow):
            yield peer.name, other(peer)


def _swarm_step(
    peer: Swarm, window: Job, count: int, exact: Array | None, size: SpeedSize, found: _Measured
) -> Callable[[], None]:
    key = (peer.name, window.schedule)

    def step() -> None:
        call = peer.prepare(window.of(count))
        costs = call()
        if exact is not None and count >= min(100, max(size.counts)):
            judged = min(count, len(exact))
            off = float(np.abs(costs[:judged] / exact[:judged] - 1.0).max())
            found.cost_error[key] = max(found.cost_error.get(key, 0.0), off)
        took = cpu_s(call, budget_s=size.budget_s, warm=False)
        found.swarm.setdefault(key, {})[count] = count / took

    return step


def _own_error_step(name: str, window: Job, found: _Measured) -> Callable[[], None]:
    def step() -> None:
        if contestants.remembers(window.network):
            exact = simulate_fine_steps(window.network, window.time, window.inputs, window.state, FINE)
        else:
            exact = contestants.oracle(window)[:, sensor_rows(window.network)]
        error = float(np.abs(contestants.our_readings(window.of(1))() - exact).max())
        took = cpu_s(contestants.ours(window.of(1)), budget_s=0.2)
        found.single.setdefault(name, {})[window.schedule] = (took, error)

    return step


def _exact_costs(window: Job) -> Array:
    from hil.bench.peers.numpy_peer import exact

    return exact(window.of(JUDGED))()


def _single_table(found: _Measured, size: SpeedSize) -> ReportTable:
    last = size.schedules[-1]
    mine = found.single.get("ours, one vector", {}).get(last, (np.nan, np.nan))[0]
    best = _per_window(found, "ours", last)
    rows: list[tuple[Cell, ...]] = []
    swarm_ms = (1e3 * _per_window(found, "ours", s) for s in size.schedules)
    rows.append(("ours, in a swarm", *swarm_ms, 1.0 / best, found.worst.get("swarm"), best / mine, 1.0))
    for name, by_schedule in found.single.items():
        times = [by_schedule.get(s, (np.nan, np.nan))[0] for s in size.schedules]
        error = max(pair[1] for pair in by_schedule.values())
        here = by_schedule.get(last, (np.nan, np.nan))[0]
        rows.append((name, *(1e3 * t for t in times), 1.0 / here, error, here / mine, here / best))
    columns = ("one vector", *size.schedules, "windows/s", "error K", "x ours", "x swarm")
    return ReportTable(
        "single",
        f"One window of {size.samples} s, one parameter vector: CPU ms where the inputs are ..",
        columns,
        tuple(rows),
        (
            f"error: the largest against matrix exponentials over all schedules. Ratios and windows/s: {last}.",
            "ivp: scipy.integrate.solve_ivp; restarted: wherever an input changes, so that no step crosses a jump.",
            "x ours: times our one vector; x swarm: times our window in the best swarm. Peers get their "
            "coefficients made beforehand; ours includes everything from parameters to cost. Pipes and lags remember: "
            f"six modules are judged by {FINE} plain steps a second that follow every piece of water, themselves "
            "good to about 1e-05 K.",
        ),
    )


def _per_window(found: _Measured, name: str, schedule: str) -> float:
    """Return the CPU seconds of a window in the best swarm."""
    return 1.0 / max(found.swarm.get((name, schedule), {}).values(), default=float("nan"))


def _swarm_table(found: _Measured, size: SpeedSize) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for (name, schedule), by_count in found.swarm.items():
        own = found.swarm.get(("ours", schedule), {})
        common = max((c for c in by_count if c in own), default=None)
        ratio = own[common] / by_count[common] if common is not None else None
        error = found.cost_error.get((name, schedule))
        rows.append((name, schedule, *(by_count.get(c) for c in size.counts), error, ratio))
    rows.sort(key=lambda row: contestants.ALL.index(str(row[1])))
    return ReportTable(
        "swarm",
        f"Swarms: windows of {size.samples} s per CPU second, cost only, one thread",
        ("method", "inputs", *(f"N={_short(c)}" for c in size.counts), "cost off", "ours is x"),
        tuple(rows),
        (
            f"cost off: largest relative difference to the exact cost over {JUDGED} particles. "
            "ours is x: at the largest swarm that both did. C is one Taylor step of order 5 a second, which is as "
            "accurate. radiation: the loop with a radiating tank. six modules: ten volumes with pipes.",
        ),
    )


def _short(count: int) -> str:
    """Format ten thousand as `10k`."""
    return f"{count // 1000}k" if count >= 1000 else str(count)


def _goal_table(
    found: _Measured, size: SpeedSize, whole: list[tuple[Cell, ...]], facts: dict[str, float]
) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []

    def row(name: str, value: float | None, goal: float, *, most: bool = False) -> None:
        if value is None or not np.isfinite(value):
            return
        met = value <= goal if most else value >= goal
        rows.append((name, value, f"{'<=' if most else '>='} {number(goal)}", "yes" if met else "no"))

    for schedule in size.schedules:
        mine = 1.0 / _per_window(found, "ours", schedule)
        row(f"windows/s, linear, {schedule}", mine, 1e6)
        row(f"of C, 16 lanes, {schedule}", mine * _per_window(found, "C, 16 lanes", schedule), 0.9)
    last = size.schedules[-1]
    for (name, schedule), by_count in found.swarm.items():
        if name.startswith("ours, "):
            row(f"windows/s, {name[6:]}", max(by_count.values()), 0.4e6 if "radiation" in name else 0.3e6)
            row(f"error, {name[6:]}, K", found.single[name][schedule][1], MATCHED_K, most=True)
    row(f"error, linear, {JUDGED} particles, K", found.worst.get("swarm"), MATCHED_K, most=True)
    row("error, linear, every corner of the bounds, K", found.worst.get("corners"), MATCHED_K, most=True)
    matched = {
        peer.name: found.single[peer.name][last][0]
        for peer in contestants.singles()
        if peer.solve_ivp and found.single.get(peer.name, {}).get(last, (0.0, np.inf))[1] <= MATCHED_K
    }
    if matched:
        name = min(matched, key=lambda n: matched[n])
        row(f"x {name}, {last}", matched[name] / _per_window(found, "ours", last), 1e5)
    row(f"x jax, {last}", _per_window(found, "jax, RK4", last) / _per_window(found, "ours", last), 10.0)
    if whole and size.whole_h == FULL.whole_h:
        row("40 h forward, readings, CPU ms", float(whole[0][1] or np.nan), 3.0, most=True)
    row(f"memory of a swarm of {size.memory_count:,}, MB", facts.get("memory_MB"), 50.0, most=True)
    row("first call in a new process, nothing cached, CPU s", facts.get("cold_s"), 2.0, most=True)
    row("first call in a new process, cached, CPU s", facts.get("cached_s"), 0.6, most=True)
    return ReportTable("goals", "Against the goals", ("what", "measured", "goal", "met"), tuple(rows))
