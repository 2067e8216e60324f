"""Commissioning: the fit of a twin to a healthy record, the reference for all later comparisons.

A segment of the record, the last one whose inputs stay within the range of the rest, is held out before the fit. The
quoted errors are of a free run through the whole record, over that segment. Standard errors are widened because
residuals are not white: by their size against the declared noise and by their autocorrelation time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from twin.calibrators.base import rmse
from twin.calibrators.identifiability import UNIDENTIFIABLE_SHARE, condition_number
from twin.commissioning.notes import notes_of
from twin.commissioning.record import HealthyRecord
from twin.gauss_newton import FitData, GaussianPrior, GaussNewtonFit, Scaling, fit_parameters
from twin.kernel import Kernel
from twin.network import Array, Network, Revision, TwinFileError
from twin.quantiles import NORMAL90
from twin.segments import simulate_segments

FEWEST, FEWEST_IN_TIME = 10, 50
"""Residuals from which a variance is estimated, and from which an autocorrelation time is."""
THINNED_S = 10.0
"""Interval of the samples from which the descents begin, s: the bin of a diagnosis, short beside a volume's memory."""
INITIAL_SD_K = 5.0
"""Standard deviation of the initial state's prior, K: wide, because most records begin in motion."""


@dataclass(frozen=True)
class CommissionResult:
    """A commissioned twin and the uncertainty of its parameters. Per-parameter mappings go by parameter id.

    Attributes
    ----------
    network
        The new revision, with its parent and errors entered; save it under a new name.
    values, start
        Fitted and initial values, in the parameters' units.
    standard_error, interval90
        Standard error and 90 % interval, in the same units.
    unidentifiable
        Parameters that the record does not determine; their values come from the prior.
    at_bound
        Parameters that ended on a bound.
    rmse_before, rmse_after, rmse_fitted
        K per sensor: free-running over `held_out_s` before and after the fit, and over the fitted segment. NaN for a
        sensor without a measurement there.
    covariance
        (q, q) of the fitted values in the optimiser's variables, as `gauss_newton.Scaling` maps them.
    condition
        Condition number of the data's correlation matrix of the tunables.
    state
        (s * k,) degC at the beginning of each fitted segment.
    evaluations
        Linearisations over all starts.
    """

    network: Network
    values: Mapping[str, float]
    start: Mapping[str, float]
    standard_error: Mapping[str, float]
    interval90: Mapping[str, tuple[float, float]]
    unidentifiable: tuple[str, ...]
    at_bound: tuple[str, ...]
    rmse_before: Mapping[str, float]
    rmse_after: Mapping[str, float]
    rmse_fitted: Mapping[str, float]
    held_out_s: tuple[float, float]
    covariance: Array
    condition: float
    state: Array
    evaluations: int
    notes: tuple[str, ...] = field(default=())

    def sample(self, count: int, seed: int = 0) -> Array:
        """Draw full parameter vectors (count, p) from the fit's covariance, inside the bounds."""
        scaling = Scaling.of(self.network, tuple(self.values))
        rng = np.random.default_rng(seed)
        z = scaling.to_z(self.network.values[scaling.index])
        draws = rng.multivariate_normal(z, self.covariance, count, method="cholesky")
        full = np.tile(self.network.values, (count, 1))
        full[:, scaling.index] = scaling.to_values(draws)
        return full


@dataclass(frozen=True)
class CommissionOptions:
    """Options of `commission`.

    Attributes
    ----------
    tunables
        Name of a set of the twin, ids, or None for every parameter of status tunable. A twin without a set "commission"
        uses the latter.
    held_out
        Share of the record's time, 0.05 to 0.5, that is held out: its end. Where inputs there leave the range of the
        rest (a fan that was only off at last), the last segment before in which they do not.
    starts
        Descents from different points: the twin's own values, then random ones by `seed`.
    seed
        Seed of the random starts.
    initial_sd
        Standard deviation of the initial state's prior, K; small for a record that begins at rest.
    made_by
        Origin for the twin file's revision.
    """

    tunables: str | Iterable[str] | None = "commission"
    held_out: float = 0.2
    starts: int = 4
    seed: int = 0
    initial_sd: float = INITIAL_SD_K
    made_by: str = "commission"


DEFAULT_OPTIONS = CommissionOptions()


def commission(
    network: Network,
    time_s: ArrayLike,
    inputs: ArrayLike,
    measured: ArrayLike,
    options: CommissionOptions = DEFAULT_OPTIONS,
) -> CommissionResult:
    """Fit the tunables and the initial state to a healthy record.

    Parameters
    ----------
    network
        The present twin; it stays unchanged.
    time_s
        (N,) s, not decreasing.
    inputs
        (N, c) in the order of ``network.input_columns``; NaN holds the last good value.
    measured
        (N, m) degC in the order of ``network.sensor_names``; NaN is masked.
    options
        Tunables, held-out share, starts and priors.

    Returns
    -------
    CommissionResult
        The commissioned twin, errors in K over the held-out segment, and standard errors.

    Raises
    ------
    TwinFileError
        Time goes back, there are too few samples or no finite measurement, tunables are unknown, or an option is out of
        range.

    Notes
    -----
    Bounded Gauss-Newton descents (`twin.gauss_newton`) from several starts, on samples `THINNED_S` apart; the best goes
    on with all samples. The prior of the last descent is as strong against the data as the residuals are far from white
    (`variance_inflation`).
    """
    ids = _checked_tunables(network, options)
    record = HealthyRecord.of(network, time_s, inputs, measured, options.held_out)
    kernel, scaling = Kernel(network, ids), Scaling.of(network, ids)
    data, all_states = record.data(), record.first_states()
    start, state = network.values[scaling.index], all_states[: len(data.begins) * len(network.nodes)]
    prior = weak_prior(scaling, start, state, options.initial_sd)
    fits = _descents(kernel, scaling, network, data.thinned(THINNED_S), state, prior, options)
    best = min(fits, key=lambda f: f.cost)
    agree = sum(f.cost < best.cost * 1.001 for f in fits), len(fits)

    def residual_of(values: Array, state: Array) -> Array:
        """Return the residual (n, m), K, of a free run through the whole record."""
        full = network.values.copy()
        full[scaling.index] = values
        states = np.concatenate([state, all_states[len(state) :]])
        run = simulate_segments(kernel, full[None], states[None], record.time, record.inputs, record.segments.begins)
        return record.residual_of(run[0])

    seen, stale = record.fitted, residual_of(start, state)
    widened = variance_inflation(residual_of(best.values, best.state)[seen], network.sigma)
    # Residuals that are not white are worth fewer samples than there are. Without this, model error would
    # drive a parameter that the record does not identify to a bound.
    tempered = GaussianPrior(prior.mean, prior.precision * widened)
    best = fit_parameters(kernel, scaling, network.values, data, best.values, best.state, tempered)
    residual = residual_of(best.values, best.state)
    covariance = np.asarray(np.linalg.inv(best.normal / widened + prior.precision), dtype=np.float64)
    spread = np.sqrt(np.diag(covariance)[: len(ids)])
    identified = spread / scaling.prior_sd() < UNIDENTIFIABLE_SHARE
    low, high = (scaling.to_values(scaling.to_z(best.values) + s * NORMAL90 * spread) for s in (-1.0, 1.0))
    errors = _Errors.of(network, stale[~seen], residual[~seen], residual[seen])
    notes = tuple(notes_of(record, ids, agree, start, best, identified, widened))
    values = dict(zip(ids, best.values.tolist(), strict=True))
    return CommissionResult(
        network=network.with_values(values, _revision(record, data, errors, notes, options.made_by)),
        values=values,
        start=dict(zip(ids, start.tolist(), strict=True)),
        standard_error=dict(zip(ids, (spread * scaling.slope(best.values)).tolist(), strict=True)),
        interval90={name: (float(a), float(b)) for name, a, b in zip(ids, low, high, strict=True)},
        unidentifiable=tuple(name for name, ok in zip(ids, identified, strict=True) if not ok),
        at_bound=tuple(name for name, hit in zip(ids, best.at_bound, strict=True) if hit),
        rmse_before=errors.before,
        rmse_after=errors.after,
        rmse_fitted=errors.fitted,
        held_out_s=record.held_out_s,
        covariance=covariance[: len(ids), : len(ids)],
        condition=condition_number(best.normal[: len(ids), : len(ids)]),
        state=best.state,
        evaluations=sum(f.evaluations for f in fits) + best.evaluations,
        notes=notes,
    )


def _checked_tunables(network: Network, options: CommissionOptions) -> tuple[str, ...]:
    """Return the ids of the parameters to fit.

    Raises
    ------
    TwinFileError
        There are none, or an option is out of range.
    """
    tunables = options.tunables
    if tunables == "commission" and "commission" not in network.sets:
        tunables = None
    ids = network.tunables(tunables)
    if not ids:
        raise TwinFileError(f"twin {network.name!r} has no tunables; set the status of at least one parameter")
    if not 0.05 <= options.held_out <= 0.5:
        raise TwinFileError(f"held_out must be between 0.05 and 0.5, got {options.held_out:g}")
    if not options.initial_sd > 0.0:
        raise TwinFileError(f"initial_sd must be above 0 K, got {options.initial_sd:g}")
    return ids


def _descents(
    kernel: Kernel,
    scaling: Scaling,
    network: Network,
    data: FitData,
    state: Array,
    prior: GaussianPrior,
    options: CommissionOptions,
) -> list[GaussNewtonFit]:
    """Return the fits from the twin's own values and from random ones."""
    rng, start = np.random.default_rng(options.seed), network.values[scaling.index]
    fits: list[GaussNewtonFit] = []
    for k in range(max(options.starts, 1)):
        z = scaling.to_z(start) + (rng.normal(0.0, scaling.prior_sd()) if k else 0.0)
        fits.append(fit_parameters(kernel, scaling, network.values, data, scaling.to_values(z), state, prior))
    return fits


@dataclass(frozen=True)
class _Errors:
    """Root mean square errors per sensor, K, as `CommissionResult` has them."""

    before: dict[str, float]
    after: dict[str, float]
    fitted: dict[str, float]

    @classmethod
    def of(cls, network: Network, *residuals: Array) -> _Errors:
        """Return the errors of residuals (., m), K: held out before and after the fit, and fitted."""
        return cls(*(dict(zip(network.sensor_names, rmse(r), strict=True)) for r in residuals))

    def finite(self) -> tuple[dict[str, float], ...]:
        """Return the errors of sensors that have a reading there."""
        return tuple({k: v for k, v in e.items() if np.isfinite(v)} for e in (self.before, self.after, self.fitted))


def _revision(record: HealthyRecord, data: FitData, errors: _Errors, notes: tuple[str, ...], made_by: str) -> Revision:
    """Return the entry of the new revision in its twin file."""
    before, after, fitted = errors.finite()
    return Revision(
        number=record.network.revision.number + 1,
        parent=record.network.digest,
        made_by=made_by,
        window_s=(float(data.time[0]), float(data.time[-1])),
        held_out_s=record.held_out_s,
        error_before_K=before,
        error_after_K=after,
        error_fitted_K=fitted,
        notes=notes,
    )


def weak_prior(scaling: Scaling, values: Array, state: Array, state_sd: float) -> GaussianPrior:
    """Return a prior centred on `values` (q,) and `state` (k,), as wide as `Scaling.prior_sd` and `state_sd` K."""
    sd = np.concatenate([scaling.prior_sd(), np.full(state.size, state_sd)])
    return GaussianPrior(np.concatenate([scaling.to_z(values), state]), np.diag(sd**-2.0))


def variance_inflation(residual: Array, sigma: Array) -> float:
    """Return the number of declared-noise samples that one sample of these residuals is worth, at least 1.

    The product of reduced chi-square and autocorrelation time (initial positive sequence, Geyer 1992), for the worst
    sensor.

    Parameters
    ----------
    residual
        (n, m) K, NaN where missing.
    sigma
        (m,) K, declared noise.
    """
    worst = 1.0
    for j in range(residual.shape[1]):
        r = residual[np.isfinite(residual[:, j]), j]
        if r.size < FEWEST:
            continue
        chi = float(np.mean(r**2) / sigma[j] ** 2)
        worst = max(worst, chi * (_correlation_time(r - r.mean()) if r.size >= FEWEST_IN_TIME else 1.0))
    return worst


def _correlation_time(r: Array) -> float:
    """Return the autocorrelation time of r (n,) in samples, 1 for white noise."""
    spectrum = np.abs(np.fft.rfft(r, 2 * r.size)) ** 2
    correlation = np.fft.irfft(spectrum)[: r.size // 2]
    correlation = correlation / max(correlation[0], 1e-300)
    negative = np.flatnonzero(correlation < 0.05)
    until = int(negative[0]) if negative.size else correlation.size
    return 1.0 + 2.0 * float(correlation[1:until].sum())
