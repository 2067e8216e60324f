"""Tables of the trial: errors of the outlet, trainings, ablations, and the remedy against learning by heart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hil.bench.measure import Cell, ReportTable
from hil.bench.rivals.contestants import HIERA, REMEDY, Contestant
from hil.bench.rivals.training import Trained
from twin.calibrators.hiera_unet.tower.predict import interval
from twin.calibrators.hiera_unet.tower.score import MethodPrediction, Targets, scores
from twin.tower.air import Array

GAUSS_NEWTON, BOOSTED = "Gauss-Newton with discrepancy", "the same, boosted"
NOT_STOPPED = "last step"
STOPPED = "early stopping"


class Answers:
    """Corrections of the test windows by method and seed, with the figures of their trainings.

    Parameters
    ----------
    targets
        Of the test windows.
    sizes
        Stations and windows of each split.
    seconds
        Processor seconds of each training.
    """

    def __init__(self, targets: Targets, sizes: Mapping[str, tuple[int, int]], seconds: float) -> None:
        self.targets, self.sizes, self.seconds = targets, dict(sizes), seconds
        self.kinds: dict[str, str] = {}
        self.found: dict[str, list[MethodPrediction]] = {}
        self.last: dict[str, list[MethodPrediction]] = {}
        self.spent: dict[str, list[float]] = {}
        self.weights: dict[str, int] = {}
        self.trainings: list[tuple[Cell, ...]] = []

    def add_given(self, name: str, answer: MethodPrediction) -> None:
        """Add a method without a training."""
        self.kinds[name], self.found[name] = "given", [answer]

    def add_boosted(
        self, answer: MethodPrediction, known: Mapping[str, tuple[MethodPrediction, Targets]], spent: float
    ) -> None:
        """Add boosted trees of one seed, with their answers to training and validation windows."""
        self.kinds[BOOSTED] = "trees"
        self.found.setdefault(BOOSTED, []).append(answer)
        self.spent.setdefault(BOOSTED, []).append(spent)
        shares = {
            s: 100.0 * (_error(a.water, g.true_water) / _error(g.water, g.true_water) - 1.0)
            for s, (a, g) in known.items()
        }
        test = self._change(answer)
        seed = len(self.found[BOOSTED]) - 1
        self.trainings.append(
            (BOOSTED, seed, None, None, shares["train"], shares["validation"], test, None, test, spent)
        )

    def add_trained(self, one: Contestant, trained: Trained) -> None:
        """Add a training of one seed."""
        t, name = self.targets, one.name
        self.kinds[name], self.weights[name] = one.kind, trained.weights
        stopped, last = (MethodPrediction(t.mean, t.water + c) for c in (trained.stopped, trained.last))
        self.found.setdefault(name, []).append(stopped)
        self.last.setdefault(name, []).append(last)
        self.spent.setdefault(name, []).append(trained.seconds + trained.stopped_s)
        seed = len(self.found[name]) - 1
        self.trainings.append(
            (
                name,
                seed,
                trained.steps,
                trained.chosen,
                100.0 * trained.learned,
                100.0 * trained.validation,
                self._change(last),
                100.0 * trained.chosen_validation,
                self._change(stopped),
                trained.seconds + trained.stopped_s,
            )
        )

    def tables(self) -> tuple[ReportTable, ...]:
        """Return all tables."""
        found = [self._outlet(), self._trainings()]
        if HIERA in self.found:
            found.append(self._parts())
        if HIERA in self.found and REMEDY in self.found:
            found.append(self._remedy())
        return tuple(found)

    def _change(self, answer: MethodPrediction) -> float:
        """Return the error of the outlet on test windows over that of Gauss-Newton, less one, in per cent."""
        t = self.targets
        return 100.0 * (_error(answer.water, t.true_water) / _error(t.water, t.true_water) - 1.0)

    def _outlet(self) -> ReportTable:
        rows: list[tuple[Cell, ...]] = []
        base = self.found[GAUSS_NEWTON]
        for name, answers in self.found.items():
            each = [scores(self.targets, one) for one in answers]
            mae = [one["water_mae_K"] for one in each]
            means = [float(np.mean([one[k] for one in each])) for k in ("water_rmse_K", "water_mae_after_fan_change_K")]
            more = [None, None, None] if name == GAUSS_NEWTON else [*self._against(answers, base)]
            spent = self.spent.get(name)
            rows.append(
                (
                    name,
                    len(answers),
                    float(np.mean(mae)),
                    min(mae),
                    max(mae),
                    *means,
                    *more,
                    self.weights.get(name),
                    None if spent is None else float(np.mean(spent)),
                )
            )
        count, windows = self.sizes["test"]
        columns = (
            "method",
            "seeds",
            "MAE K",
            "best seed K",
            "worst seed K",
            "RMSE K",
            "30 min after a fan change K",
            "change %",
            "95 % from",
            "to",
            "weights",
            "processor s",
        )
        notes = (
            "change: of the mean absolute error against Gauss-Newton, mean over seeds; its interval is a bootstrap of "
            f"{count} stations: it lacks the spread of the seeds, and with so few it is too narrow",
            "all networks learn the outlet alone and read the whole day with the target; the TCN alone reads no later "
            "block of ten minutes",
            f"each network has {self.seconds:g} processor seconds of steps a seed; evaluations are in the last column",
            "networks: weights of the evaluation with the least error on validation stations, 0 steps among them",
        )
        about = f"Outlet against the truth on {count} stations that no training saw, {windows} windows, readings hidden"
        return ReportTable("outlet", about, columns, tuple(rows), notes)

    def _trainings(self) -> ReportTable:
        columns = (
            "method",
            "seed",
            "steps",
            "chosen step",
            "training stations %",
            "validation %",
            "test %",
            "chosen: validation %",
            "chosen: test %",
            "processor s",
        )
        learned, validation = (self.sizes[s] for s in ("train", "validation"))
        notes = (
            "change of the outlet's error against Gauss-Newton, by the last weights and by the chosen ones",
            f"{learned[0]} training stations with {learned[1]} windows, {validation[0]} validation stations with "
            f"{validation[1]}",
        )
        return ReportTable("trainings", "Each training", columns, tuple(self.trainings), notes)

    def _parts(self) -> ReportTable:
        rows = []
        for name, answers in self.found.items():
            if self.kinds[name] != "ablation":
                continue
            part = name.removeprefix(f"{HIERA}, ")
            rows.append(
                (
                    part,
                    len(answers),
                    *self._against(self.last[name], self.last[HIERA]),
                    *self._against(answers, self.found[HIERA]),
                )
            )
        columns = (
            "part left out",
            "seeds",
            "last step: change %",
            "95 % from",
            "to",
            "early stopping: change %",
            "95 % from ",
            "to ",
        )
        notes = (
            "above zero: the part helps; intervals are a bootstrap of stations, of the mean error over seeds",
            "no hierarchy: all stages behind the first have tokens of ten minutes, as the rivals have",
        )
        about = "Small Hiera-UNet without a part, against the whole one, the same processor seconds"
        return ReportTable("parts", about, columns, tuple(rows), notes)

    def _remedy(self) -> ReportTable:
        rows: list[tuple[Cell, ...]] = []
        base = self.found[GAUSS_NEWTON]
        for weights, some in ((NOT_STOPPED, self.last), (STOPPED, self.found)):
            for against, rival in (("Gauss-Newton", base * len(some[REMEDY])), (HIERA, some[HIERA])):
                change, low, high = self._against(some[REMEDY], rival)
                rows.append((weights, against, change, low, high, _verdict(low, high)))
        columns = ("weights", "against", "change %", "95 % from", "to", "verdict")
        notes = (
            "the correction has no mean over a target, and is trained on the start's error without its mean",
            "helps, harms: the interval excludes zero",
        )
        about = "Remedy against learning by heart: the mean of a window is left to the fit"
        return ReportTable("remedy", about, columns, tuple(rows), notes)

    def _against(self, ours: list[MethodPrediction], rival: list[MethodPrediction]) -> tuple[float, float, float]:
        """Return the change of the error in per cent, with its interval by a bootstrap of stations."""
        cell = self.targets.cell.astype(np.int64)
        sizes = [np.mean([self._window_error(one) for one in some], axis=0) for some in (ours, rival)]
        change, low, high = interval(sizes[0], sizes[1], cell, np.random.default_rng(0))
        return 100.0 * change, 100.0 * low, 100.0 * high

    def _window_error(self, answer: MethodPrediction) -> Array:
        error: Any = np.abs(answer.water - self.targets.true_water)
        there = np.isfinite(error)
        count = there.sum(axis=1)
        total = np.where(there, error, 0.0).sum(axis=1)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _verdict(low: float, high: float) -> str:
    return "helps" if high < 0.0 else "harms" if low > 0.0 else "not distinguishable"


def _error(water: Array, true_water: Array) -> float:
    return float(np.nanmean(np.abs(water - true_water)))
