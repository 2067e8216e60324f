"""Fit of one window against a Gaussian prior: identifiable parameters, their values and the posterior.

A parameter is held at its prior mean if the window neither identifies it (`identifiability`) nor contradicts the held
value. The latter is a score test (Rao, Proc. Camb. Phil. Soc. 44 (1948) 50) on each held parameter after the fit of
the others. A parameter that fails it is released, so holding never prevents following a change. A released
parameter moves, but loosely: it stands for others with the same effect.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.calibrators.base import Window, normalised_misfit
from twin.calibrators.identifiability import WindowInformation, window_information
from twin.calibrators.results import CalibrationReport
from twin.calibrators.structural_error import (
    error_size,
    model_error,
    persistent_error_covariance,
    sample_sd,
    sampling_interval,
)
from twin.gauss_newton import FitData, FitProblem, GaussianPrior, GaussNewtonFit, Scaling
from twin.kernel import Kernel, mask_measurements
from twin.network import Array, Network

CONTRADICTED = 9.0
"""Score statistic (chi-square, one degree of freedom) above which a held parameter is released."""
FIRST_SHARE = 0.3
"""Width of the first prior, around the commissioned values, as a share of the full prior."""
QUIET_SHARE = 0.02
"""Process noise per window, as a share of the full prior, while the live twin's error is that of a healthy one."""
ROUNDS = 3
TOLERANCE = 1e-5
"""Releases of held parameters at most, and relative change of the cost at which a fit has converged."""
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
        (q, q) of the errors in z. Held parameters keep their prior variance; their errors, and the twin's structural
        error, are in those of the others.
    held, loose
        (q,) bool, parameters that stayed, and parameters that moved though they are not identifiable by themselves.
    info
        Information of the window alone.
    chi
        Reduced chi-square of the data, at least 1.
    """

    fit: GaussNewtonFit
    covariance: Array
    held: np.ndarray
    loose: np.ndarray
    info: WindowInformation
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
            window_errors=self.info.window_errors(scaling, self.fit.values),
            condition=self.info.condition,
        )


@dataclass(frozen=True)
class Descent:
    """Start of a descent, (q + k,) parameters in z and the state, degC, and its largest number of linearisations.

    Without a start it is the mean of the prior.
    """

    first: Array | None = None
    most: int = 25


def fit_window(
    kernel: Kernel,
    scaling: Scaling,
    sigma: Array,
    window: Window,
    before: WindowPrior,
    *,
    info: WindowInformation | None = None,
    noise: float = 1.0,
    descent: Descent | None = None,
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
    info
        Information of the window, if it is known already.
    noise
        Share of `sigma` squared that is noise. Identifiability and contradiction are judged by that alone: otherwise a
        change that hides behind the twin's own error would never be followed.
    descent
        Start and length of the descent.
    """
    first, most = (descent or Descent()).first, (descent or Descent()).most
    mean, covariance, state = before.mean, before.covariance, before.state
    q, k = mean.size, len(kernel.network.nodes)
    data = window_data(window, sigma)
    count = max(int((data.weight > 0.0).sum()), 1)
    state_precision = np.eye(k) * max(window.error_K, STATE_SD) ** -2
    centre = np.concatenate([mean, state[:k]])
    of_state = np.zeros(k, dtype=bool)
    problem = FitProblem(kernel, scaling, window.parameters, data, state)
    info = info or window_information(problem.linearise(centre).jtj, scaling.prior_sd(), noise)
    held = info.unidentifiable
    v = centre if first is None else np.concatenate([np.where(held, mean, first[:q]), first[q:]])
    at = problem.linearise(v)
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
    free = ~of_all
    gain = np.zeros((q + k, q + k))
    gain[np.ix_(free, free)] = np.linalg.inv((fit.normal + prior.precision)[np.ix_(free, free)])
    error = persistent_error_covariance(problem, fit.v, gain, error_size(window, kernel.network))
    error += gain @ fit.normal @ gain * max(square, noise)
    before_fit = _blocks(covariance, np.asarray(np.linalg.inv(state_precision)))
    posterior = np.asarray(error + _remaining_error(before_fit, gain, fit.normal))
    return WindowPosterior(fit, 0.5 * (posterior + posterior.T)[:q, :q], held, info.unidentifiable & ~held, info, chi)


def _remaining_error(before: Array, gain: Array, information: Array) -> Array:
    """Return the covariance of what remains of the errors before a fit.

    An estimate moves by -gain J'J e for errors e of what is fitted and of what is held. The rows of `gain` for held
    variables are zero: their errors stay, and the others stand for them as well (Schmidt, Advances in Control Systems
    3 (1966) 293). It holds for a gain that is not optimal, too (Gelb, Applied Optimal Estimation, 1974, sec. 7.2).
    """
    transition = np.eye(len(gain)) - gain @ information
    remaining: Array = transition @ before @ transition.T
    return remaining


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


class ParameterBelief:
    """Belief about q parameters from window to window, in z: mean, and covariance of its errors.

    Attributes
    ----------
    mean, covariance
        (q,) and (q, q). The covariance is the one that is reported, and the next window's prior.
    """

    def __init__(self, network: Network, scaling: Scaling) -> None:
        self._network, self._wide = network, scaling.prior_sd()
        self._commissioned = scaling.to_z(network.values[scaling.index])
        self.mean = self._commissioned.copy()
        self.covariance = np.diag((FIRST_SHARE * self._wide) ** 2)

    def weight(self, window: Window) -> tuple[Array, float]:
        """Return the standard deviation (m,) of a sample, K or the reading's unit, and the noise's share of it."""
        weight = sample_sd(self._network, sampling_interval(window.time))
        return weight, float(np.mean((self._network.sigma / weight) ** 2))

    def before(self, window: Window) -> WindowPrior:
        """Return the prior of a window: the belief, opened by the misfit of the live twin."""
        sigma = np.hypot(self._network.sigma, model_error(self._network))
        opened = np.clip(0.3 * (normalised_misfit(window, sigma) - 1.0), QUIET_SHARE, 1.0)
        return WindowPrior(self.mean, self.covariance + np.diag((opened * self._wide) ** 2), window.state)

    def take(self, done: WindowPosterior) -> WindowPosterior:
        """Take on the posterior of a window and return it with its covariance limited; a failed fit changes nothing."""
        if not (np.isfinite(done.fit.cost) and np.isfinite(done.covariance).all()):
            return done
        self.mean = done.fit.v[: self.mean.size].copy()
        self.covariance = self.limited(done.covariance, self.mean)
        return replace(done, covariance=self.covariance)

    def limited(self, covariance: Array, z: Array) -> Array:
        """Return the covariance (q, q) of the errors of an estimate z (q,), no larger than without any data.

        Plausible values lie around the commissioned ones. So an estimate is off from them by its distance to the
        commissioned value and by their width, in the root mean square.
        """
        return limit_covariance(covariance, self.widest(z))

    def widest(self, z: Array) -> Array:
        """Return the largest standard deviation (q,) of the error of an estimate z (q,)."""
        widest: Array = np.hypot(self._wide, z - self._commissioned)
        return widest


def limit_covariance(covariance: Array, wide: Array) -> Array:
    """Shrink a covariance whose standard deviations exceed `wide`; its correlations stay."""
    factor = np.minimum(wide / np.sqrt(np.diag(covariance)), 1.0)
    shrunk: Array = covariance * np.outer(factor, factor)
    return shrunk
