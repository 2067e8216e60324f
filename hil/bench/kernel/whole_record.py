"""Forty hours tracked window by window: cost of calibrators that continue from the window before."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.bench.kernel.windows import drive, steady_start
from hil.bench.measure import Cell, ReportTable, median
from hil.run.session import ProgressBar
from twin import Array, Network, TwinTracker, simulate
from twin.calibrators import UNTRAINED_CALIBRATORS, Calibration, Calibrator, Window, make_calibrator

LEVEL_S = 900


@dataclass(slots=True)
class Clocked:
    """Calibrator whose CPU seconds are counted; satisfies `Calibrator`."""

    inner: Calibrator
    cpu_s: list[float] = field(default_factory=list)
    name: str = ""
    ids: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.name, self.ids = self.inner.name, self.inner.ids

    def calibrate(self, window: Window) -> Calibration:
        began = time.process_time()
        done = self.inner.calibrate(window)
        self.cpu_s.append(time.process_time() - began)
        return done

    def state(self) -> dict[str, Any]:
        return self.inner.state()

    def restore(self, state: Mapping[str, Any]) -> None:
        self.inner.restore(state)


def drifting(network: Network, hours: float, seed: int) -> tuple[Array, Array, Array]:
    """Return time (n,), inputs (n, c) and noisy readings (n, m) of a loop whose radiator loses a fifth on the way."""
    samples = int(hours * 3600)
    time_s = np.arange(samples, dtype=np.float64)
    inputs = np.repeat(drive(network, "each s", -(-samples // LEVEL_S), seed)[1], LEVEL_S, axis=0)[:samples]
    readings, state = [], steady_start(network)
    edges = np.linspace(0, samples, 41).astype(int)
    for part, (first, stop) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        values = network.values.copy()
        values[network.index(["fins.UA_100"])[0]] *= 1.0 - 0.2 * part / 40.0
        rows = slice(first, min(stop + 1, samples))
        out = simulate(network, time_s[rows], inputs[rows], state, values)
        readings.append(out[: stop - first])
        state = network.initial_state(out[-1])
    noise = np.random.default_rng(seed).standard_normal((samples, len(network.sensors)))
    return time_s, inputs, np.vstack(readings) + network.sigma * noise


def whole_table(network: Network, hours: float, seed: int) -> ReportTable:
    """Measure every calibrator with every set of tunables over one drifting record."""
    time_s, inputs, readings = drifting(network, hours, seed)
    plan = [
        (name, tunables)
        for name in UNTRAINED_CALIBRATORS
        for tunables in (("paper4",) if name == "pso_paper" else ("paper4", "nine", "twelve"))
    ]
    rows: list[tuple[Cell, ...]] = []
    with ProgressBar(f"tracking {hours:g} h", len(plan)) as bar:
        for done, (name, tunables) in enumerate(plan):
            bar.update(done, f"{name}, {tunables}")
            clocked = Clocked(make_calibrator(name, network, tunables, seed))
            tracker = TwinTracker(network, clocked)
            began = time.process_time()
            update = tracker.push(time_s, inputs, readings)
            took = time.process_time() - began
            errors = [c.error_K for c in update.calibrations]
            rows.append(
                (
                    name,
                    str(len(clocked.ids)),
                    len(errors),
                    sum(clocked.cpu_s),
                    took,
                    1e3 * median(clocked.cpu_s),
                    median(errors),
                    max(errors, default=float("nan")),
                )
            )
    noise = float(np.sqrt(np.mean(network.sigma**2)))
    return ReportTable(
        "whole",
        f"{hours:g} h in sequence, radiator slowly fouling: CPU time of all windows",
        ("calibrator", "tunables", "windows", "fits s", "all s", "a fit ms", "RMSE K", "worst K"),
        tuple(rows),
        (
            f"all s: with the predictions of both twins. The noise alone is {noise:.4f} K RMSE; machine code of the "
            "first window included.",
        ),
    )
