"""Scores of the predictions of `hil bench hiera`: errors, recovery, parameters, coverage, with their scatter."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from hil.bench.hiera.contestants import BlindPredictions, CaseInputs
from twin import Array

IN_A_ROW = 2
"""Targets that must stay below the threshold for a recovery to count."""
RESAMPLES = 400
WORSE, WORSE_K = 1.1, 0.005
"""Factor and K by which an error must be larger to count as worse."""
CONFIDENCE = 0.90


@dataclass(frozen=True)
class HieraScore:
    """Score of one contestant on one case.

    Attributes
    ----------
    rmse
        (n,) K of each target, over sensors.
    after
        (n,) bool, targets with at least one whole window after the change behind them.
    before
        (n,) bool, those of a rig in which nothing has changed yet.
    recovered
        Targets until its prediction was right again, the first whole one after the change being 1; infinite for never,
        NaN where nothing was to recover from.
    off
        (n, P) parameter errors over their Cramer-Rao bounds, NaN where the label does not count.
    sure
        (n, P) the same over the half widths of the contestant's own 90 % intervals, NaN where it gives none.
    error
        (n, 120, Y) K, prediction minus truth.
    half
        Its own half widths, or None.
    calibrated
        (n,) bool.
    cpu_s
        A window.
    """

    rig: str
    kind: str
    seed: int
    case: str
    rmse: Array
    before: np.ndarray
    after: np.ndarray
    recovered: float
    off: Array
    sure: Array
    error: Array
    half: Array | None
    calibrated: np.ndarray
    cpu_s: float


def score(given: CaseInputs, answer: BlindPredictions, plain: BlindPredictions, threshold_K: float) -> HieraScore:
    """Score predictions; `plain` is that of the commissioned twin, which shows if there is anything to recover from."""
    case = given.case
    truth = case.truth()
    error = answer.readings - truth
    targets = np.array(case.targets)
    changed = case.onset < len(case.campaign.series)
    before = targets < (case.onset // 120) if changed else np.ones(len(targets), dtype=bool)
    after = targets > case.first_after if changed else np.zeros(len(targets), dtype=bool)
    rmse, lost = _rmse(error), _rmse(plain.readings - truth)
    recovered = float("nan")
    if changed and after.any() and np.nanmean(lost[targets >= case.first_after]) > threshold_K:
        recovered = _recovered(rmse[targets >= case.first_after], threshold_K)
    with np.errstate(invalid="ignore", divide="ignore"):
        wrong = np.where(given.known, answer.theta - given.theta, np.nan)
        off = np.where(np.isfinite(given.floor), wrong / given.floor, np.nan)
        sure = np.full(wrong.shape, np.nan) if answer.theta_half is None else wrong / answer.theta_half
    return HieraScore(
        case.rig,
        case.kind,
        case.seed,
        case.name,
        rmse,
        before,
        after,
        recovered,
        off,
        sure,
        error,
        answer.half,
        answer.calibrated,
        answer.cpu_s,
    )


def _rmse(error: Array) -> Array:
    good = np.isfinite(error)
    count = good.sum(axis=(1, 2))
    squares = (np.where(good, error, 0.0) ** 2).sum(axis=(1, 2))
    return np.where(count > 0, np.sqrt(squares / np.maximum(count, 1)), np.nan)


def _recovered(rmse: Array, threshold_K: float) -> float:
    below = rmse < threshold_K
    for k in range(len(below) - IN_A_ROW + 1):
        if below[k : k + IN_A_ROW].all():
            return float(k + 1)
    return float("inf")


def pooled(scores: Iterable[HieraScore], which: Callable[[HieraScore], np.ndarray]) -> float:
    """Return the RMSE over the chosen targets of all cases, K."""
    chosen = [s.rmse[which(s)] for s in scores]
    squares = np.concatenate(chosen) ** 2 if chosen else np.zeros(0)
    squares = squares[np.isfinite(squares)]
    return float(np.sqrt(squares.mean())) if squares.size else float("nan")


def typical(scores: Iterable[HieraScore], which: Callable[[HieraScore], np.ndarray]) -> float:
    """Return the median of the targets' RMSE, K."""
    chosen = [s.rmse[which(s)] for s in scores]
    values = np.concatenate(chosen) if chosen else np.zeros(0)
    values = values[np.isfinite(values)]
    return float(np.median(values)) if values.size else float("nan")


def share_recovered(scores: Iterable[HieraScore], within: float) -> float:
    """Return the share of changes that were recovered from within this number of targets; NaN without any change."""
    needed = np.array([s.recovered for s in scores])
    needed = needed[~np.isnan(needed)]
    return float((needed <= within).mean()) if needed.size else float("nan")


def worse(scores: list[HieraScore], rival: list[HieraScore]) -> float:
    """Return the share of changes after which the error is clearly larger than the rival's on the same case."""
    lost = []
    for own, other in zip(scores, rival, strict=True):
        if np.isnan(own.recovered):
            continue
        a, b = (pooled([s], lambda s: s.after) for s in (own, other))
        lost.append(a > WORSE * b and a > b + WORSE_K)
    return float(np.mean(lost)) if lost else float("nan")


def over_bound(scores: Iterable[HieraScore], *, accepted: bool = False, told: bool = False) -> float:
    """Return the root mean square of parameter errors over their Cramer-Rao bounds: 1 is the optimum.

    Parameters
    ----------
    accepted
        Only of windows before which the contestant said that it was calibrated.
    told
        Only of parameters that it gave an interval, so not of those that it held.
    """
    values = _over_bound(scores, accepted, told)
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def median_over_bound(scores: Iterable[HieraScore], *, accepted: bool = False) -> float:
    """Return the median of |error| over bound; 0.67 for an efficient estimate. Arguments are as of `over_bound`."""
    values = np.abs(_over_bound(scores, accepted, told=False))
    return float(np.median(values)) if values.size else float("nan")


def _over_bound(scores: Iterable[HieraScore], accepted: bool, told: bool) -> Array:
    chosen = []
    for s in scores:
        rows = (s.after | s.before) & (s.calibrated | (not accepted))
        chosen.append(np.where(np.isfinite(s.sure) | (not told), s.off, np.nan)[rows].ravel())
    values = np.concatenate(chosen or [np.zeros(0)])
    return values[np.isfinite(values)]


def sure(scores: Iterable[HieraScore], which: Callable[[HieraScore], np.ndarray]) -> float:
    """Return the share of parameters inside their own 90 % intervals, over the chosen targets; NaN without any."""
    values = np.concatenate([s.sure[which(s)].ravel() for s in scores] or [np.zeros(0)])
    values = np.abs(values[~np.isnan(values)])
    return float((values <= 1.0).mean()) if values.size else float("nan")


def falsely_calibrated(scores: Iterable[HieraScore], threshold_K: float) -> float:
    """Return the share of targets with a calibrated flag before them that the contestant then missed."""
    missed = [s.rmse[s.calibrated] > threshold_K for s in scores]
    values = np.concatenate(missed) if missed else np.zeros(0)
    return float(values.mean()) if values.size else float("nan")


def constant_widths(scores: Iterable[HieraScore], seed: int) -> Array:
    """Return half widths (Y,), K, of split conformal prediction from other cases: one score for each target and sensor.

    Shafer & Vovk, J. Mach. Learn. Res. 9 (2008) 371; the step within a target is drawn at random, since errors within
    one are alike.
    """
    rng = np.random.default_rng([seed, 37])
    drawn = []
    for s in scores:
        known = np.where(np.isfinite(s.error), rng.random(s.error.shape), -1.0)
        step = known.argmax(axis=1)
        drawn.append(np.abs(np.take_along_axis(s.error, step[:, None], axis=1)[:, 0]))
    values = np.concatenate(drawn)
    widths = []
    for column in values.T:
        ordered = np.sort(column[np.isfinite(column)])
        rank = int(np.ceil((ordered.size + 1) * CONFIDENCE))
        widths.append(float(ordered[rank - 1]) if 0 < rank <= ordered.size else float("inf"))
    return np.array(widths)


def own_factors(scores: Iterable[HieraScore], seed: int) -> Array:
    """Return factors (Y,) that calibrate a contestant's own half widths: normalised split conformal."""
    relative = [replace(s, error=s.error / s.half) for s in scores if s.half is not None]
    return constant_widths(relative, seed)


def tally(s: HieraScore, widths: Array, *, own: bool = False) -> tuple[float, float, int]:
    """Return the number of errors inside half widths (Y,), K, the sum of full widths, and the number of errors.

    Parameters
    ----------
    own
        `widths` are factors on the contestant's own half widths; without those, all is nought.
    """
    half = np.broadcast_to(widths, s.error.shape) if not own else None if s.half is None else s.half * widths
    if half is None:
        return 0.0, 0.0, 0
    good = np.isfinite(s.error)
    return float((np.abs(s.error) <= half)[good].sum()), float(2.0 * half[good].sum()), int(good.sum())


def coverage(scores: Iterable[HieraScore], widths: Array, *, own: bool = False) -> tuple[float, float]:
    """Return coverage and mean full width, K; the arguments are those of `tally`."""
    inside, total, known = np.sum([(0.0, 0.0, 0), *(tally(s, widths, own=own) for s in scores)], axis=0).tolist()
    return (inside / known, total / known) if known else (float("nan"), float("nan"))


def interval(
    scores: list[HieraScore], figure: Callable[[list[HieraScore]], float], seed: int = 0
) -> tuple[float, float, float]:
    """Return a figure and its middle 90 % in a bootstrap over cases."""
    value = figure(scores)
    if len(scores) < 2:
        return value, float("nan"), float("nan")
    rng = np.random.default_rng([seed, 41])
    drawn = [figure([scores[i] for i in rng.integers(0, len(scores), len(scores))]) for _ in range(RESAMPLES)]
    known = [v for v in drawn if np.isfinite(v)]
    if not known:
        return value, float("nan"), float("nan")
    low, high = np.quantile(known, [0.05, 0.95])
    return value, float(low), float(high)
