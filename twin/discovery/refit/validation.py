"""Cross-validation of effects: they must predict each fold of time, with an embargo on either side of it.

An effect's sizes are fitted to the other folds, and the embargo is as long as the rig's memory. Everything is linear
about the fit. For each fold the tunables and the sizes are solved from the other folds, once with the effects and once
without. Both predict the fold, and so does the twin as commissioned, with and without the effects. The whitened
residual is transformed back from cosines into time, where a row belongs to a moment.

Source: h-block cross-validation (Burman, Chow & Nolan, Biometrika 81 (1994) 351).
"""

from __future__ import annotations

import numpy as np
from scipy.fft import idct
from scipy.linalg import block_diag

from twin.discovery.diagnosis import Fold
from twin.discovery.effects.probe import FreeRun
from twin.discovery.records.grid import centred
from twin.discovery.refit.fitting import Fit
from twin.discovery.refit.model import Model
from twin.discovery.scoring.score_tests import ScoreTest
from twin.network import Array

BLOCKS = 4
"""Cross-validation folds."""
REACH = 20.0
"""Prior range of a size, in typical sizes."""
TOLD = 3.0
"""Standard errors by which a size from the other folds must differ from zero for a fold to be predicted."""
LOST_SHARE = 0.1
"""Share of the gaining folds' gain that the losing ones may lose."""
MUTE, MUTE_SHARE = 10.0, 0.01
"""Gain in weighted squares, and share of all gains, up to which a fold is uninformative."""


def validate(score_test: ScoreTest, model: Model, fitted: Fit) -> tuple[Fold, ...]:
    """Return the cross-validation folds of a fit; the score test then holds the fit's residual."""
    grid, sizes = score_test.grid, np.array([e.size for e in fitted.entries])
    at = fitted.state[None, :], fitted.values[None, :], sizes[None, :]
    runs = model.run(grid.time, grid.inputs, *at, begins=grid.begins)
    readings = centred(runs[0], grid.centre)
    score_test.look_at(FreeRun(readings, readings), fitted.moved)
    b, m = score_test.b, score_test.m
    signatures = score_test.signatures(np.stack([e.placed(score_test) for e in fitted.entries]))
    # The initial state is told by the first readings alone: it stays as fitted, whichever block is left out.
    q = score_test.probe.q
    slopes = _in_time(score_test.slopes[:, :q], b, m)
    prior = score_test.prior.precision[:q, :q]
    effects = _in_time(signatures, b, m)
    left = _in_time(score_test.residual[:, None], b, m)[:, :, 0]
    without = left + effects @ sizes
    commissioned = without + slopes @ fitted.moved[:q]
    both = np.concatenate([slopes, effects], axis=2)
    weak = np.diag([(REACH * e.candidate.typical) ** -2.0 for e in fitted.entries])
    precision, moved = block_diag(prior, weak), np.concatenate([fitted.moved[:q], sizes])
    start = float(score_test.grid.time[0])
    edges = np.linspace(0, b, BLOCKS + 1).round().astype(int)
    folds = []
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        train = np.ones(b, dtype=bool)
        train[max(first - score_test.memory, 0) : last + score_test.memory] = False
        if train.sum() < 0.2 * b:
            continue
        inside = score_test.known[first:last]
        rest = slice(first, last)
        if not _told(both, train & score_test.known.T, precision, sizes):
            continue
        tuned = _predict(slopes, without, train & score_test.known.T, rest, prior, fitted.moved[:q])
        full = _predict(both, left, train & score_test.known.T, rest, precision, moved)
        added = _predict(effects, commissioned - effects @ sizes, train & score_test.known.T, rest, weak, sizes)
        # Re-tuning may do worse elsewhere than leaving the twin alone, with the effects and without; the better of the
        # two with them has to beat the better without.
        bare, best = (
            min(float((x[inside] ** 2).sum()) for x in pair) for pair in ((tuned, commissioned[rest]), (full, added))
        )
        gain = bare - best
        span = score_test.step_s
        folds.append(Fold(start + first * span, start + last * span, int(inside.sum()), gain))
    return tuple(folds)


def holds(folds: tuple[Fold, ...]) -> bool:
    """Return True if the effects predict: three in four informative folds gain, and the others lose little."""
    least = max(MUTE, MUTE_SHARE * sum(abs(f.gain) for f in folds))
    speaking = [f.gain for f in folds if abs(f.gain) > least]
    won, lost = sum(g for g in speaking if g > 0.0), -sum(g for g in speaking if g < 0.0)
    enough = sum(g > 0.0 for g in speaking) >= 0.75 * len(speaking) - 1e-9
    return not speaking or (enough and lost <= LOST_SHARE * won)


def _told(slopes: Array, seen: np.ndarray, precision: Array, sizes: Array) -> bool:
    """Return True if the rows `seen` (m, b) identify the sizes (e,), the last columns of the derivatives (b, m, c)."""
    rows = slopes[seen.T]
    hessian = rows.T @ rows + precision
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-30))
    covariance = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0)) / scale
    return bool((sd[-len(sizes) :] * TOLD < np.abs(sizes)).all())


def _predict(slopes: Array, left: Array, seen: np.ndarray, rest: slice, precision: Array, moved: Array) -> Array:
    """Return the prediction error (t, m) of the fold `rest`, solved from the rows `seen` (m, b).

    Args:
        slopes: (b, m, c). left: (b, m). precision: (c, c) of the prior, from whose mean the fit is `moved` (c,).
    """
    rows, target = slopes[seen.T], left[seen.T]
    hessian = rows.T @ rows + precision
    pull = rows.T @ target - precision @ moved
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-30))
    move = np.linalg.lstsq(hessian / np.outer(scale, scale), pull / scale, rcond=1e-12)[0] / scale
    found: Array = left[rest] - slopes[rest] @ move
    return found


def _in_time(whitened: Array, b: int, m: int) -> Array:
    series: Array = idct(whitened.reshape(b, m, -1), type=2, norm="ortho", axis=0)
    return series
