"""Benchmark `hil bench posterior`: widths, centres and coverage of each calibrator against a sampled posterior.

Every calibrator begins with the same prior and receives the same window. The posterior has that prior, and the model of
errors that the calibrators state: noise, and an error of the twin that is constant for five minutes. It treats no
parameter as held and linearises nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hil.bench.measure import Cell, ReportTable
from hil.bench.peers import Absent
from hil.bench.posterior.windows import PosteriorWindow, posterior_windows
from twin import Array
from twin.calibrators import Calibration, Calibrator, make_calibrator
from twin.calibrators.posterior import STATE_SD, fit_window
from twin.calibrators.pso import ParticleSwarm
from twin.calibrators.structural_error import PERSISTENCE_S, error_size, sample_sd, sampling_interval
from twin.gauss_newton import Scaling
from twin.kernel import Kernel
from twin.quantiles import NORMAL90

if TYPE_CHECKING:
    from hil.bench.posterior.nuts import Draws, WindowModel

CALIBRATORS = ("pso", "least_squares", "kalman")
QUANTILES = (0.05, 0.95)
STATES = ("healthy", "changed")


@dataclass(frozen=True, slots=True)
class PosteriorSize:
    """Size of the benchmark: windows of simulated and of virtual rigs, steps of the chain for adaptation and kept."""

    simulated: int = 12
    virtual: int = 8
    warmup: int = 200
    draws: int = 600


FULL = PosteriorSize()
QUICK = PosteriorSize(simulated=2, virtual=0, warmup=100, draws=200)


@dataclass(frozen=True)
class Compared:
    """Intervals of one calibrator on one window, of the parameters that it did not hold (r,), in z.

    Attributes
    ----------
    by, rig, state
        Calibrator, and kind and state of the rig.
    ratio
        Its width over that of the posterior.
    shift
        Its centre less the posterior's mean, in standard deviations of the posterior.
    own, posterior
        1 if the truth is inside, 0 if not, NaN without a truth.
    """

    by: str
    rig: str
    state: str
    ratio: Array
    shift: Array
    own: Array
    posterior: Array


def measure(
    size: PosteriorSize, seed: int, say: Callable[[float, str], None]
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the tables, and a line for everything left out.

    Parameters
    ----------
    size
        Size of the benchmark.
    seed
        Seed of rigs, calibrators and chains.
    say
        Called with the share that is done, and each window's name.
    """
    try:
        from hil.bench.posterior.nuts import PosteriorSampler
    except ImportError:
        return (), (str(Absent("numpyro: not installed (pip install -e '.[bench]')")),)
    compared: list[Compared] = []
    sampled: list[Draws] = []
    sampler: PosteriorSampler | None = None
    total = size.simulated + size.virtual
    for number, case in enumerate(posterior_windows(size.simulated, size.virtual, seed)):
        say(number / total, f"{case.rig}, {case.state}")
        ids = case.network.tunables("nine")
        scaling = Scaling.of(case.network, ids)
        sampler = sampler or PosteriorSampler(case.network, ids, size.warmup, size.draws)
        model, start = stated_model(case, scaling)
        draws = sampler.draw(model, start, seed + number)
        sampled.append(draws)
        if not draws.converged:
            say(number / total, f"{case.rig}, {case.state}: R-hat {draws.r_hat:.2f}, left out")
            continue
        compared += [_compare(name, case, scaling, draws, seed) for name in CALIBRATORS]
    return (_widths(compared), _coverage(compared), _chains(sampled)), ()


def stated_model(case: PosteriorWindow, scaling: Scaling) -> tuple[WindowModel, Array]:
    """Return the statistical model that the calibrators state for a window, and the fit of least squares (q + k,)."""
    from hil.bench.posterior.nuts import WindowModel

    network, window = case.network, case.window
    weight = sample_sd(network, sampling_interval(window.time))
    noise = float(np.mean((network.sigma / weight) ** 2))
    fit = fit_window(Kernel(network, scaling.ids), scaling, weight, window, case.before, noise=noise).fit
    square = float(fit.sse.sum()) / max(int(np.isfinite(window.measured).sum()), 1)
    q, k = len(scaling.ids), len(network.nodes)
    covariance = np.eye(q + k) * max(window.error_K, STATE_SD) ** 2
    covariance[:q, :q] = case.before.covariance
    mean = np.concatenate([case.before.mean, case.before.state[:k]])
    white = weight * np.sqrt(max(square, noise))
    segment = ((window.time - window.time[0]) // PERSISTENCE_S).astype(int)
    return WindowModel(window, mean, covariance, white, error_size(window, network), segment), fit.v


def calibrated(name: str, case: PosteriorWindow, scaling: Scaling, seed: int) -> Calibration:
    """Return the calibration of the window by a calibrator that knows the same before it as every other."""
    made: Calibrator = make_calibrator(name, case.network, seed=seed)
    state = made.state()
    mean, covariance = case.known.mean.tolist(), case.known.covariance.tolist()
    if isinstance(made, ParticleSwarm):
        state |= {"belief": [mean, covariance], "best": made.positions(scaling.to_values(case.known.mean)).tolist()}
    else:
        state |= {"mean": mean, "covariance": covariance}
    made.restore(state)
    return made.calibrate(case.window)


def _compare(name: str, case: PosteriorWindow, scaling: Scaling, draws: Draws, seed: int) -> Compared:
    done = calibrated(name, case, scaling, seed)
    assert done.covariance is not None
    values = np.array([done.values[i] for i in scaling.ids])
    free = np.array([i not in done.frozen for i in scaling.ids])
    half = NORMAL90 * np.sqrt(np.diag(done.covariance)) / scaling.slope(values)
    centre, truth = scaling.to_z(values), scaling.to_z(case.truth)
    low, high = np.quantile(draws.z, QUANTILES, axis=0)
    own = np.where(np.isfinite(truth), np.abs(centre - truth) <= half, np.nan)
    inside = np.where(np.isfinite(truth), (low <= truth) & (truth <= high), np.nan)
    shift = (centre - draws.z.mean(axis=0)) / draws.z.std(axis=0)
    return Compared(name, case.rig, case.state, (2.0 * half / (high - low))[free], shift[free], own[free], inside[free])


def _groups(compared: list[Compared]) -> list[tuple[str, str, list[Compared]]]:
    keys = [(by, state) for by in CALIBRATORS for state in STATES]
    every = [(by, state, [c for c in compared if (c.by, c.state) == (by, state)]) for by, state in keys]
    return [group for group in every if group[2]]


def _widths(compared: list[Compared]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for by, state, own in _groups(compared):
        ratio = np.concatenate([c.ratio for c in own])
        shift = np.concatenate([c.shift for c in own])
        spread = f"{np.quantile(ratio, 0.1):.2f} to {np.quantile(ratio, 0.9):.2f}"
        far = float(np.quantile(np.abs(shift), 0.9))
        rows.append((by, state, len(own), ratio.size, float(np.median(ratio)), spread, *_middle(shift), far))
    return ReportTable(
        "widths",
        "90 % intervals of calibrators against the posterior by NUTS",
        ("by", "rig", "windows", "intervals", "width ratio", "10 to 90 %", "shift", "|shift|", "90 %"),
        tuple(rows),
        (
            "Width ratio: the calibrator's interval over the posterior's 5 to 95 %. Shift: its centre less the mean of "
            "the posterior, in standard deviations of the latter; median, median size, 90 % quantile of the size.",
            "All begin with the same prior and window. Parameters that a calibrator held are left out.",
        ),
    )


def _middle(shift: Array) -> tuple[float, float]:
    return float(np.median(shift)), float(np.median(np.abs(shift)))


def _coverage(compared: list[Compared]) -> ReportTable:
    rows: list[tuple[Cell, ...]] = []
    for by, state, own in _groups(compared):
        inside = np.concatenate([c.own for c in own])
        posterior = np.concatenate([c.posterior for c in own])
        good = np.isfinite(inside)
        if good.any():
            rows.append((by, state, int(good.sum()), float(inside[good].mean()), float(posterior[good].mean())))
    return ReportTable(
        "coverage",
        "True values inside the 90 % intervals of the same windows",
        ("by", "rig", "values", "calibrator", "posterior"),
        tuple(rows),
        ("A rig with an effect that the twin lacks has the true values of its own parameters.",),
    )


def _chains(sampled: list[Draws]) -> ReportTable:
    kept = [s for s in sampled if s.converged]
    row: tuple[Cell, ...] = (
        len(sampled),
        len(sampled) - len(kept),
        sum(s.attempts for s in sampled),
        sum(s.divergent for s in kept),
        max((s.r_hat for s in kept), default=float("nan")),
        max(s.r_hat for s in sampled),
        max(s.kernel_K for s in sampled),
    )
    return ReportTable(
        "chains",
        "Quality of the chains, and the kernel against jax",
        ("windows", "left out", "chains", "divergent", "worst R-hat", "worst of all", "kernel K"),
        (row,),
        (
            "Left out: windows whose chain had not converged at the last attempt; they are in no other table. Each "
            "attempt adapts twice as long as the one before. Divergent draws and the worst R-hat are of the windows "
            "kept.",
            "Kernel: largest difference of a reading between the twin's kernel and the integration by jax.",
        ),
    )
