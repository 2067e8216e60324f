"""Fit of one window against a Gaussian prior: identifiable parameters, their values and the posterior.

A parameter is held at its prior mean if the window neither identifies it (`identifiability`) nor contradicts the held
value. The latter is a score test (Rao, Proc. Camb. Phil. Soc. 44 (1948) 50) on each held parameter after the fit of
the others. A parameter that fails it is released, so holding never prevents following a change. A released
parameter moves, but loosely: it stands for others with the same effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.calibrators.base import Window
from twin.calibrators.identifiability import WindowInformation, window_information
from twin.calibrators.results import CalibrationReport
from twin.gauss_newton import FitData, FitProblem, GaussianPrior, GaussNewtonFit, Scaling
from twin.kernel import Kernel, mask_measurements
from twin.network import Array

CONTRADICTED = 9.0
"""Score statistic (chi-square, one degree of freedom) above which a held parameter is released."""
ROUNDS = 3
TOLERANCE = 1e-5
STATE_SD = 0.02
"""Least prior standard deviation of a carried state, K."""


@dataclass(frozen=True)
class WindowPrior:
    """Gaussian prior of a window: `mean` (q,) and `covariance` (q, q) in z, and the prior mean of the state, degC."""

    mean: Array
    covariance: Array
    state: Array


@dataclass(frozen=True)
class WindowPosterior:
    """Posterior of q parameters after a window.

    Attributes
    ----------
    fit
        The minimum.
    covariance
        (q, q) in z; held parameters keep their prior variance, uncorrelated.
    held, loose
        (q,) bool, parameters that stayed, and parameters that moved though they are not identifiable by themselves.
    told
        Information of the window alone.
    chi
        Reduced chi-square of the data, at least 1.
    """

    fit: GaussNewtonFit
    covariance: Array
    held: np.ndarray
    loose: np.ndarray
    told: WindowInformation
    chi: float

    def report(self, scaling: Scaling) -> CalibrationReport:
        """Return the covariance in physical units, and the warnings that belong to the values."""
        slope = scaling.slope(self.fit.values)
        frozen = tuple(i for i, hit in zip(scaling.ids, self.held, strict=True) if hit)
        flags = [f"{i} is not identifiable: held" for i in frozen]
        flags += [
            f"{i} is not identifiable by itself: it stands for others too"
            for i, hit in zip(scaling.ids, self.loose, strict=True)
            if hit
        ]
        bound = self.fit.at_bound & ~self.held
        flags += [f"{i} at its bound" for i, hit in zip(scaling.ids, bound, strict=True) if hit]
        return CalibrationReport(
            covariance=self.covariance * np.outer(slope, slope),
            flags=tuple(flags),
            frozen=frozen,
            window_errors=self.told.window_errors(scaling, self.fit.values),
            condition=self.told.condition,
        )


def fit_window(
    kernel: Kernel,
    scaling: Scaling,
    sigma: Array,
    window: Window,
    before: WindowPrior,
    *,
    told: WindowInformation | None = None,
    noise: float = 1.0,
    most: int = 25,
) -> WindowPosterior:
    """Fit tunables and initial state to a window.

    Parameters
    ----------
    kernel, scaling
        The compiled network and the scaling of the tunables.
    sigma
        (m,) K noise of the sensors.
    window
        The window.
    before
        Prior of the parameters and the state.
    told
        Information of the window, if it is known already.
    noise
        Share of `sigma` squared that is noise. Identifiability and contradiction are judged by that alone: otherwise a
        change that hides behind the twin's own error would never be followed.
    most
        Largest number of linearisations in one descent.
    """
    mean, covariance, state = before.mean, before.covariance, before.state
    q, k = mean.size, len(kernel.network.nodes)
    data = window_data(window, sigma)
    count = max(int((data.weight > 0.0).sum()), 1)
    state_precision = np.eye(k) * max(window.error_K, STATE_SD) ** -2
    centre = np.concatenate([mean, state[:k]])
    of_state = np.zeros(k, dtype=bool)
    problem = FitProblem(kernel, scaling, window.parameters, data, state)
    v, at = centre, problem.linearise(centre)
    told = told or window_information(at.jtj, scaling.prior_sd(), noise)
    held = told.unidentifiable
    for _ in range(ROUNDS):
        inverse = np.asarray(np.linalg.inv(_independent(covariance, held)))
        prior = GaussianPrior(centre, _blocks(inverse, state_precision))
        of_all = np.concatenate([held, of_state])
        fit = problem.minimise(v, prior, first=at, held=of_all, most=most, tolerance=TOLERANCE)
        square = float(fit.sse.sum()) / count
        release = _contradicted(fit, held, prior, max(square, noise))
        if not release.any():
            break
        held, v, at = held & ~release, fit.v, fit.data
    chi = max(square, 1.0)
    information = fit.normal / chi
    information[:q][held] = 0.0
    information[:, :q][:, held] = 0.0
    posterior = np.asarray(np.linalg.inv(information + prior.precision))[:q, :q]
    return WindowPosterior(fit, 0.5 * (posterior + posterior.T), held, told.unidentifiable & ~held, told, chi)


def window_data(window: Window, sigma: Array) -> FitData:
    """Return the window's samples with their weights."""
    return FitData(window.time, window.inputs, *mask_measurements(window.measured, sigma))


def _contradicted(fit: GaussNewtonFit, held: np.ndarray, prior: GaussianPrior, chi: float) -> np.ndarray:
    """Return the held parameters (q,) that would lower the cost significantly if they alone were released."""
    q = held.size
    out = np.zeros(q, dtype=bool)
    if not held.any():
        return out
    hessian = fit.normal / chi + prior.precision
    gradient = fit.data.jtr / chi + prior.precision @ (fit.v - prior.mean)
    free = np.concatenate([~held & ~fit.at_bound, np.ones(fit.v.size - q, dtype=bool)])
    which = np.flatnonzero(held)
    cross = hessian[np.ix_(which, free)]
    solved = np.linalg.solve(hessian[np.ix_(free, free)], np.column_stack([cross.T, gradient[free]]))
    information = np.diag(hessian)[which] - (cross * solved[:, :-1].T).sum(axis=1)
    pull = gradient[which] - cross @ solved[:, -1]
    out[which] = pull**2 > CONTRADICTED * np.maximum(information, 1e-300)
    return out


def _blocks(a: Array, b: Array) -> Array:
    out = np.zeros((len(a) + len(b), len(a) + len(b)))
    out[: len(a), : len(a)], out[len(a) :, len(a) :] = a, b
    return out


def _independent(covariance: Array, held: np.ndarray) -> Array:
    """Return the covariance with correlations between held and open parameters dropped."""
    independent: Array = covariance * (held[:, None] == held[None, :])
    return independent


def limit_covariance(covariance: Array, wide: Array) -> Array:
    """Shrink a covariance whose standard deviations exceed `wide`; its correlations stay."""
    factor = np.minimum(wide / np.sqrt(np.diag(covariance)), 1.0)
    shrunk: Array = covariance * np.outer(factor, factor)
    return shrunk
