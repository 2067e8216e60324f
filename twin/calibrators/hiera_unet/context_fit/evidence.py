"""Gauss-Newton fit of a window's context: the network's evidence token, and its rival.

Gauss-Newton from the commissioned values with a Gaussian prior (`twin.gauss_newton`), initial state included, over
segments before the target whose lengths double from some minutes to nearly two hours. A change of the rig in between
contradicts the longer ones. The longest fit is selected that explains its data nearly as well as the shortest does
(Lepski's principle: Lepskii, Theory Probab. Appl. 35 (1991) 454). Its standard errors are widened for residuals that
are larger than noise and not white.

A fit changes every parameter. The sparse posterior (`sparse`), in which few have changed, follows from its normal
equations and stands beside it.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np

from twin.calibrators.hiera_unet.context_fit.sparse import Likelihood, Posterior, Usual, posterior
from twin.calibrators.hiera_unet.data.features import Features, Frame
from twin.calibrators.hiera_unet.data.parameters import REACH, Deviations
from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.calibrators.hiera_unet.data.signals import stuck
from twin.calibrators.hiera_unet.data.windows import CONTEXT, TARGET
from twin.calibrators.identifiability import condition_number, window_information
from twin.calibrators.structural_error import CORRELATED_S, MODEL_K
from twin.commissioning import variance_inflation
from twin.gauss_newton import FitData, FitProblem, GaussianPrior, GaussNewtonFit
from twin.network import Array

HORIZONS = (CONTEXT - TARGET, 720, 360, 180, 90, 45)
"""Steps before the target that are fitted."""
FITTED = CONTEXT - TARGET - 1
"""Step of a window before which its context is fitted. Of this step, the last one before the target, half of the
samples are still to come when a service reads it for the first time."""
LIMIT = 80.0
"""Condition number above which a set of parameters counts as not identifiable."""
SMALL = 0.2
"""Standard error, as a share of the prior's, below which a parameter is identifiable whatever the condition number."""
STATE_SD = 0.3
WORSE, LEAST_CHI = 1.25, 0.6
"""Factor by which a longer fit's mean square may exceed that of a shorter one, and the least such mean square."""
CORRELATED_STEPS = CORRELATED_S / STEP_S
"""Correlation time of a healthy twin's error in steps: so many count as one."""
MOST = 8
LARGEST_LOG_CONDITION = 8.0
LASTING, TAKEN_ON = 0.25, 10.0
"""Steps that count as one in the sparse posterior: this share of those fitted, and so many times the residuals'
correlation time. A fit compensates for most of the model error, which then shows in no residual, and model error
persists (docs/decisions/0034)."""
MOVED, SLAB, SPIKE = (0.04, 0.05, 0.1), 0.3, 0.01
"""Prior of training's rigs: change probability of a deviation, by law; its standard deviation if it has changed, and if
not."""


@dataclass(frozen=True)
class ContextFit:
    """Fit over the context.

    Attributes:
        theta, sd: (P,) deviations and standard errors, no wider than the prior. condition: of all P together.
        told: (P,) bool, parameters that the fitted data identify (`tell`).
        chi: mean square of the residuals in units of noise. steps: fitted steps of the context.
        start: full state at the first fitted step, under theta. state: at the first target step.
        likelihood: of the deviations, the initial state integrated out, `widened` steps counting as one.
        evaluations: linearisations.
    """

    theta: Array
    sd: Array
    condition: float
    told: np.ndarray
    chi: float
    steps: int
    start: Array
    state: Array
    likelihood: Likelihood
    widened: float
    evaluations: int

    def kept(self) -> Array:
        """Return the numbers (4 + 3 P + P (P + 1) / 2,) that a store keeps for `tokens_of`.

        They are log chi, log of the fitted share of the context, deltas, standard errors, log10 condition, log of the
        widening, likelihood.
        """
        share = self.steps / (CONTEXT - TARGET)
        condition = min(np.log10(max(self.condition, 1.0)), LARGEST_LOG_CONDITION)
        first = [np.log(self.chi), np.log(share)]
        last = [condition, np.log(self.widened)]
        return np.concatenate([first, self.theta, self.sd, last, self.likelihood.plain()])

    def tokens(self, deviations: Deviations) -> Array:
        """Return the tokens that the network reads, see `tokens_of`."""
        return tokens_of(self.kept(), deviations)


def tokens(count: int) -> int:
    """Return the number of values in `tokens_of` for `count` parameters."""
    return 2 + 5 * count + 1


def tokens_of(kept: Array, deviations: Deviations) -> Array:
    """Return the tokens (2 + 5 P + 1,) of `ContextFit.kept`.

    Log chi, log share; deltas and standard errors of the fit; means, standard deviations and change probabilities of
    the sparse posterior; log10 condition.
    """
    count = len(deviations)
    few = believed(kept, deviations)
    fit, condition = kept[: 2 + 2 * count], kept[2 + 2 * count]
    return np.concatenate([fit, few.mean, few.sd, few.chance, [condition]])


def believed(kept: Array, deviations: Deviations) -> Posterior:
    """Return the sparse posterior of `ContextFit.kept`."""
    count = len(deviations)
    widened = float(np.exp(kept[3 + 2 * count]))
    data = Likelihood.of_plain(kept[4 + 2 * count :], count)
    steps = fitted_by(kept, count)[1]
    share = widened / (CORRELATED_STEPS + LASTING * steps + TAKEN_ON * widened)
    few = posterior(Likelihood(data.information * share, data.pull * share), usual(deviations))
    return replace(few, mean=np.clip(few.mean, -REACH, REACH))


def usual(deviations: Deviations) -> Usual:
    """Return the spike-and-slab prior of training's rigs."""
    count = len(deviations)
    return Usual(np.array(MOVED)[deviations.law], np.full(count, SLAB), np.full(count, SPIKE))


def fitted_by(kept: Array, count: int) -> tuple[Array, int]:
    """Return theta (P,) and the fitted steps, from `ContextFit.kept`."""
    return kept[2 : 2 + count], round(float(np.exp(kept[1])) * (CONTEXT - TARGET))


@dataclass(frozen=True)
class ParameterPrior:
    """Gaussian prior of theta (P,) with independent parts."""

    mean: Array
    sd: Array


def estimate(
    features: Features,
    frame: Frame,
    values: Array,
    horizons: tuple[int, ...] = HORIZONS,
    belief: ParameterPrior | None = None,
) -> ContextFit:
    """Fit the context of a window.

    Args:
        values: full vector (p,) of the commissioned twin. horizons: steps that are tried.
        belief: the prior of theta; by default the commissioned values and `Deviations.prior_sd`.
    """
    before = belief or _commissioned(features)
    best: tuple[GaussNewtonFit, float, int] | None = None
    evaluations = 0
    for steps in sorted(horizons):
        done = _fit(features, frame, values, steps, before)
        if done is None:
            continue
        fit, chi = done
        evaluations += fit.evaluations
        if best is None or chi <= WORSE * max(best[1], LEAST_CHI):
            best = (fit, chi, steps)
        else:
            break
    if best is None:
        return nothing(features, frame, before)
    return _conclude(features, frame, values, before, *best, evaluations)


def _commissioned(features: Features) -> ParameterPrior:
    return ParameterPrior(np.zeros(len(features.deviations)), features.deviations.prior_sd)


def nothing(features: Features, frame: Frame, belief: ParameterPrior) -> ContextFit:
    """Return the fit without any data: the prior."""
    none = np.zeros(len(belief.sd), dtype=bool)
    return ContextFit(
        belief.mean,
        belief.sd,
        1e16,
        none,
        1.0,
        HORIZONS[-1],
        frame.start,
        frame.state,
        Likelihood.nothing(len(belief.sd)),
        1.0,
        0,
    )


def _data(features: Features, frame: Frame, first: int, last: int, fitted: int | None = None) -> FitData:
    """Return steps `first` to `last` of the window; those from `fitted` on are simulated and not looked at."""
    seen = frame.measured[: last if fitted is None else fitted]
    good = np.zeros((last - first, seen.shape[1]), dtype=bool)
    good[: len(seen) - first] = (np.isfinite(seen) & ~stuck(seen))[first:]
    sigma = step_noise(features)
    return FitData(
        np.ascontiguousarray(frame.time[first:last]),
        np.ascontiguousarray(frame.held[first:last]),
        np.where(good, frame.measured[first:last], 0.0),
        np.where(good, 1.0 / sigma, 0.0),
    )


def _context(features: Features, frame: Frame, first: int) -> FitData:
    """Return the context from step `first` on, and the target's first step, which the run is to reach."""
    return _data(features, frame, first, CONTEXT - TARGET + 1, FITTED)


def read_by_estimate(frame: Frame) -> bytes:
    """Return a digest of all that `estimate` reads of a window, given the twin.

    The same two hours are read again when their target has come: ten minutes later this is the same.
    """
    digest = hashlib.blake2b(repr(frame.begin).encode())
    for array in (frame.start, frame.measured[:FITTED], frame.held[: FITTED + 1], frame.time[: FITTED + 2]):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.digest()


def step_noise(features: Features) -> Array:
    """Return the noise (Y,), K, of one step's reading: white noise over five samples, and a floor that no averaging
    removes.
    """
    return np.sqrt(features.network.sigma**2 / STEP_S + MODEL_K**2)


def _fit(
    features: Features, frame: Frame, values: Array, steps: int, belief: ParameterPrior
) -> tuple[GaussNewtonFit, float] | None:
    first = max(CONTEXT - TARGET - steps, frame.begin)
    data = _context(features, frame, first)
    count = int((data.weight > 0.0).sum())
    if count < 4 * len(features.deviations):
        return None
    problem, prior = _problem(features, frame, values, first, data, belief)
    fit = problem.minimise(prior.mean.copy(), prior, most=MOST, tolerance=1e-4)
    if not np.isfinite(fit.cost):
        return None
    return fit, max(float(fit.sse.sum()) / count, 1e-3)


def _problem(
    features: Features, frame: Frame, values: Array, first: int, data: FitData, belief: ParameterPrior
) -> tuple[FitProblem, GaussianPrior]:
    """Return the squares over theta and the state at step `first`, and the prior of both."""
    nodes = len(features.network.nodes)
    scaling = features.deviations.scaling(values)
    state = features.state_at(frame, first, values)
    centre = np.concatenate([np.clip(belief.mean, -REACH, REACH), state[:nodes]])
    # A healthy twin's errors last: without tempering, they would drive what the data cannot tell to its bound.
    precision = np.diag(np.concatenate([belief.sd, np.full(nodes, STATE_SD)]) ** -2.0) * CORRELATED_STEPS
    return FitProblem(features.kernel, scaling, values, data, state), GaussianPrior(centre, precision)


def _conclude(
    features: Features,
    frame: Frame,
    values: Array,
    belief: ParameterPrior,
    fit: GaussNewtonFit,
    chi: float,
    steps: int,
    evaluations: int,
) -> ContextFit:
    count = len(features.deviations)
    scaling = features.deviations.scaling(values)
    first = max(CONTEXT - TARGET - steps, frame.begin)
    data = _context(features, frame, first)
    residual = np.where(data.weight > 0.0, fit.data.readings - data.measured, np.nan)
    widened = variance_inflation(residual[: FITTED - first], step_noise(features))
    nodes = len(features.network.nodes)
    prior = np.diag(np.concatenate([belief.sd, np.full(nodes, STATE_SD)]) ** -2.0)
    covariance = np.linalg.inv(fit.normal / widened + prior)[:count, :count]
    told, number = tell(fit.normal, scaling.prior_sd(), widened)
    sd = np.minimum(np.sqrt(np.diag(covariance)), belief.sd)
    likely = _likelihood(fit, features.state_at(frame, first, values)[:nodes], count, widened)
    return ContextFit(
        fit.v[:count].copy(), sd, number, told, chi, steps, fit.state, fit.data.end.copy(), likely, widened, evaluations
    )


def _likelihood(fit: GaussNewtonFit, state: Array, count: int, widened: float) -> Likelihood:
    """Return the likelihood of the `count` deviations, by the normal equations at the fit.

    The initial state was `state` (k,) +- STATE_SD.
    """
    normal, slope = fit.normal / widened, fit.data.jtr / widened
    own = normal[count:, count:] + np.eye(len(state)) * STATE_SD**-2
    gain = np.linalg.solve(own, normal[count:, :count]).T
    information = normal[:count, :count] - gain @ normal[count:, :count]
    pulled = slope[count:] + (fit.v[count:] - state) * STATE_SD**-2
    information = 0.5 * (information + information.T)
    return Likelihood(information, information @ fit.v[:count] - (slope[:count] - gain @ pulled))


def tell(normal: Array, plausible: Array, widened: float = 1.0) -> tuple[np.ndarray, float]:
    """Return the identifiable parameters (q,) bool, and the condition number of all of them.

    Backward elimination as for a single window (`identifiability`), continued until the condition number of the rest is
    below `LIMIT`. A parameter whose standard error is small with all others free is identifiable in any case.

    Args:
        normal: (q + k, q + k) J'J of the data, noise-weighted. plausible: (q,) prior standard deviations.
    """
    told = window_information(normal, plausible, widened)
    q = plausible.size
    kept = [k for k in range(q) if not told.unidentifiable[k]]
    state = normal[q:, q:] / widened + np.eye(len(normal) - q) * STATE_SD**-2
    cross = normal[:q, q:] / widened
    information = (normal[:q, :q] / widened - cross @ np.linalg.solve(state, cross.T)) * np.outer(plausible, plausible)
    sure = told.spread < SMALL * plausible
    while kept and condition_number(information[np.ix_(kept, kept)]) > LIMIT:
        spread = np.diag(np.linalg.inv(information[np.ix_(kept, kept)] + 1e-12 * np.eye(len(kept))))
        del kept[int(np.argmax(spread))]
    mask = np.zeros(q, dtype=bool)
    mask[kept] = True
    return mask | sure, told.condition


def identifiable(features: Features, frame: Frame, values: Array, since: int) -> np.ndarray:
    """Return the parameters (P,) bool that are identifiable from step `since` on, target included: their labels count.

    Args:
        since: step of the window from which on the rig is unchanged.
    """
    first = max(since, frame.begin)
    none: np.ndarray = np.zeros(len(features.deviations), dtype=bool)
    if CONTEXT - first < TARGET // 2:
        return none
    data = _data(features, frame, first, CONTEXT)
    if not (data.weight > 0.0).any():
        return none
    problem, prior = _problem(features, frame, values, first, data, _commissioned(features))
    at = problem.linearise(prior.mean)
    return tell(at.jtj, features.deviations.prior_sd, CORRELATED_STEPS)[0]


def least_error(features: Features, frame: Frame, values: Array, theta: Array, since: int) -> Array:
    """Return the Cramer-Rao bound (P,) of theta's standard errors from the steps between `since` and the target.

    The initial state is free, the noise is that of `step_noise` with `CORRELATED_STEPS` counting as one, and theta the
    truth. The bound of a parameter that is not identifiable is infinite.
    """
    deviations = features.deviations
    first = max(since, frame.begin)
    if CONTEXT - TARGET - first < 12:
        return np.full(len(deviations), np.inf)
    data = _data(features, frame, first, CONTEXT - TARGET)
    problem, prior = _problem(features, frame, values, first, data, _commissioned(features))
    at = prior.mean.copy()
    at[: len(deviations)] = np.clip(np.nan_to_num(theta), -REACH, REACH)
    normal = problem.linearise(at).jtj
    return window_information(normal, deviations.prior_sd, CORRELATED_STEPS).spread
