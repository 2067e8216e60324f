"""Benchmark `hil bench ablations`: contribution of each part of the network, with equal CPU time for all variants.

Every variant has the same data, seed and schedule; a variant whose step costs more takes fewer of them. What is left
out is left out of the unseen windows as well.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.bench.measure import Cell, ReportTable
from hil.training import PIECES, TrainingData, without
from twin import Array

LEFT_OUT = ("hierarchy", "residuals", "gates", "evidence", "hiding")
PROBED = 8
"""Steps that measure the cost of one."""
FEWEST = 20
RESAMPLES = 400


@dataclass(frozen=True)
class TrainedVariant:
    """Variant trained without one part, on N held-out windows.

    Attributes
    ----------
    name
        The piece that it lacks, or "nothing".
    weights, steps
        How many.
    cpu_s
        Of its training.
    outputs, online
        (N,) K, mean absolute error, target hidden (symmetric branch) and seen (causal branch).
    parameters, moved
        (N,) mean absolute error of deviations, and of those that moved; NaN where no label counts.
    inside, width
        Share inside raw 90 % intervals of the outputs, blind, and their mean width, K.
    fit
        Outputs, parameters and moved of the Gauss-Newton fit alone.
    """

    name: str
    weights: int
    steps: int
    cpu_s: float
    outputs: Array
    online: Array
    parameters: Array
    moved: Array
    inside: float
    width: float
    fit: tuple[Array, Array, Array]


def measure(
    data: TrainingData, name: str, seed: int, minutes: float, say: Callable[[float, str], None]
) -> tuple[tuple[ReportTable, ...], tuple[str, ...]]:
    """Return the table, and everything left out.

    Parameters
    ----------
    name
        Configuration.
    minutes
        CPU time that every variant is trained for.
    say
        Called with each stage.
    """
    pieces = ((), *((piece,) for piece in LEFT_OUT))
    trials = []
    for k, less in enumerate(pieces):
        what = less[0] if less else "nothing"
        say(k / len(pieces), f"without {what}")
        trials.append(trial(data, name, seed, 60.0 * minutes, less))
    return (table(trials, rigs(data.test.nominal), minutes, len(data.train)), meanings()), ()


def trial(data: TrainingData, name: str, seed: int, budget_s: float, less: tuple[str, ...]) -> TrainedVariant:
    """Train a variant without the parts `less` for this CPU time and score it on the test windows."""
    from twin.calibrators.hiera_unet import Trainer, TrainingPlan
    from twin.calibrators.hiera_unet.training.score import MOVED, NINETY, outcome
    from twin.calibrators.hiera_unet.weights.binding import config_for, physics_of

    parts = (data.network, data.table, data.deviations)
    physics = physics_of(*parts)

    def trainer(steps: int) -> tuple[Any, TrainingData]:
        config, plan, own = without(less, config_for(name, *parts), TrainingPlan(steps=steps, seed=seed), data)
        return Trainer(config, own.train, physics, plan, digest=data.digest), own

    # Half of the probe belongs to the structure and half does not: its mean step is slightly cheaper than the rest.
    probe, _ = trainer(2 * PROBED)
    each = _cpu_s(probe, PROBED) / PROBED
    work, own = trainer(max(round(budget_s / each), FEWEST))
    spent = _cpu_s(work, work.plan.steps)
    blind, online = (
        outcome(work.average.eval(), own.test, physics.simulate, physics.told, causal=causal, hidden=hidden)
        for causal, hidden in ((False, True), (True, False))
    )
    moved = np.where(np.abs(blind.theta - blind.theta_error) > MOVED, 1.0, np.nan)
    wrong, fitted = np.abs(blind.theta_error), np.abs(blind.evidence_error)
    known = np.isfinite(blind.error)
    return TrainedVariant(
        less[0] if less else "nothing",
        sum(p.numel() for p in work.network.parameters()),
        work.plan.steps,
        spent,
        mean(np.abs(blind.error)),
        mean(np.abs(online.error)),
        mean(wrong),
        mean(moved * wrong),
        float((np.abs(blind.error) <= NINETY * blind.scale)[known].mean()),
        float(2.0 * NINETY * blind.scale[known].mean()),
        (mean(np.abs(blind.rival)), mean(fitted), mean(moved * fitted)),
    )


def _cpu_s(trainer: Any, steps: int) -> float:
    """Return the CPU seconds of this number of steps."""
    began = time.process_time()
    for _ in range(steps):
        trainer.step()
    return time.process_time() - began


def mean(values: Array) -> Array:
    """Return the mean (N,) over all but the first axis of finite values; NaN if there is none."""
    flat = values.reshape(len(values), -1)
    good = np.isfinite(flat)
    count = good.sum(axis=1)
    return np.where(count > 0, np.where(good, flat, 0.0).sum(axis=1) / np.maximum(count, 1), np.nan)


def rigs(nominal: Array) -> np.ndarray:
    """Return the number (N,) of the rig of each window, by its commissioned values (N, p)."""
    found: np.ndarray = np.unique(nominal, axis=0, return_inverse=True)[1].reshape(-1)
    return found


def table(trials: list[TrainedVariant], rig: np.ndarray, minutes: float, seen: int) -> ReportTable:
    """Compare all variants with the first, which is complete."""
    whole = trials[0]
    rows: list[tuple[Cell, ...]] = []
    for t in trials:
        row: list[Cell] = [t.name, t.steps, float(np.nanmean(t.outputs)), float(np.nanmean(t.online))]
        for own, other in ((t.parameters, whole.parameters), (t.moved, whole.moved)):
            row += [float(np.nanmean(own)), None if t is whole else _span(own - other, rig)]
        rows.append((*row, t.inside, t.width))
    _, parameters, moved = whole.fit
    more = (_span(parameters - whole.parameters, rig), _span(moved - whole.moved, rig))
    error = [float(np.nanmean(values)) for values in whole.fit]
    rows.append(("the network", 0, error[0], error[0], error[1], more[0], error[2], more[1], None, None))
    weights = ", ".join(f"{t.name} {t.weights}" for t in trials if t is whole or t.weights != whole.weights)
    return ReportTable(
        "ablations",
        f"Trained for {minutes:g} CPU minutes each, then on {len(rig)} unseen windows",
        (
            "without",
            "steps",
            "outputs K",
            "online K",
            "parameters",
            "more, from to",
            "moved",
            "more, from to ",
            "inside",
            "width K",
        ),
        tuple(rows),
        (
            f"{seen} windows to train on, 12 a step. Weights: {weights}.",
            "Mean absolute errors. Outputs: target hidden, symmetric branch; online: target seen, causal branch, as "
            "the service runs. Parameters: deviations where the data tells them; moved: those beyond 0.05. Inside, "
            "width: of raw 90 % intervals.",
            "Without the network: the Gauss-Newton fit that is its evidence.",
            "More: than with everything, middle 90 % when rigs are drawn again. One seed: it says nothing of how "
            "another training would end.",
        ),
    )


def _span(more: Array, rig: np.ndarray) -> Cell:
    """Return the middle 90 % of the mean of differences (N,) in a bootstrap over rigs."""
    rng = np.random.default_rng(43)
    good = np.isfinite(more)
    count = np.bincount(rig[good], minlength=rig.max() + 1)
    total = np.bincount(rig[good], more[good], rig.max() + 1)
    drawn = rng.integers(0, len(count), (RESAMPLES, len(count)))
    means = total[drawn].sum(axis=1) / np.maximum(count[drawn].sum(axis=1), 1)
    low, high = np.quantile(means, [0.05, 0.95])
    return f"{low:+.3f} to {high:+.3f}"


def meanings() -> ReportTable:
    """Describe the parts that are left out."""
    rows = tuple((piece, PIECES[piece]) for piece in LEFT_OUT)
    return ReportTable("meanings", "What is left out", ("without", "meaning"), rows)
