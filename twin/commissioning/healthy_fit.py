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
from twin.gauss_newton import FitData, GaussianPrior, GaussNewtonFit, Scaling, fit_parameters
from twin.kernel import Kernel, clean_time, hold_inputs, mask_measurements
from twin.network import Array, Network, Revision, TwinFileError
from twin.quantiles import NORMAL90
from twin.segments import find_segments, simulate_segments

FIRST_SAMPLES = 30
"""Readings whose mean is the first guess of the initial state, unless an input moves before."""
MOVED = 0.01
"""Share of its declared range by which an input must change to count as moved."""
BEYOND = 0.1
"""Share of an input's declared range by which a segment may leave the range of the rest."""
FEWEST, FEWEST_IN_TIME = 10, 50
"""Residuals from which a variance is estimated, and from which an autocorrelation time is."""
AT_BOUND = 1e-6
"""Share of its range within which a value that ended on a bound is at it: more than the optimiser rounds by, 1e-9."""
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
    tunables, held_out, initial_sd = options.tunables, options.held_out, options.initial_sd
    if tunables == "commission" and "commission" not in network.sets:
        tunables = None
    ids = network.tunables(tunables)
    if not ids:
        raise TwinFileError(f"twin {network.name!r} has no tunables; set the status of at least one parameter")
    if not 0.05 <= held_out <= 0.5:
        raise TwinFileError(f"held_out must be between 0.05 and 0.5, got {held_out:g}")
    t, u = clean_time(time_s), hold_inputs(network, inputs)
    y, weight = mask_measurements(measured, network.sigma)
    if not len(t) == len(u) == len(y):
        raise TwinFileError(f"time, inputs and measured differ in length: {len(t)}, {len(u)}, {len(y)}")
    if len(t) < 100 or t[-1] - t[0] < network.rules.window_s:
        raise TwinFileError(
            f"the record has {len(t)} samples over {t[-1] - t[0] if len(t) else 0:.0f} s; commissioning needs at "
            f"least 100 samples over {network.rules.window_s:.0f} s"
        )
    if not initial_sd > 0.0:
        raise TwinFileError(f"initial_sd must be above 0 K, got {initial_sd:g}")
    segments = find_segments(network, t, np.asarray(inputs, dtype=np.float64).reshape(u.shape))
    weight = np.where(segments.lost[:, None], 0.0, weight)
    split, end = _held_out(network, t, u, held_out)
    seen = np.ones(len(t), dtype=bool)
    seen[split:end] = False
    if not (weight[seen] > 0.0).any() or not (weight[~seen] > 0.0).any():
        raise TwinFileError("the record has no finite measurement in its fitted or in its held-out part")

    kernel, scaling = Kernel(network, ids), Scaling.of(network, ids)
    raw = np.where(weight > 0.0, y, np.nan)
    firsts = [slice(b, b + _before_any_input_moves(network, u[b:])) for b in segments.begins]
    every0 = np.concatenate([network.initial_state(raw[first]) for first in firsts])
    start = network.values[scaling.index]
    rows = split if end == len(t) else len(t)
    begins = tuple(b for b in segments.begins if b < rows)
    state0 = every0[: len(begins) * len(network.nodes)]
    data = FitData(t[:rows], u[:rows], y[:rows], np.where(seen[:, None], weight, 0.0)[:rows], begins)
    prior = weak_prior(scaling, start, state0, initial_sd)
    rng = np.random.default_rng(options.seed)
    fits: list[GaussNewtonFit] = []
    thin = data.thinned(THINNED_S)
    for k in range(max(options.starts, 1)):
        z = scaling.to_z(start) + (rng.normal(0.0, scaling.prior_sd()) if k else 0.0)
        fits.append(fit_parameters(kernel, scaling, network.values, thin, scaling.to_values(z), state0, prior))
    best = min(fits, key=lambda f: f.cost)
    agree = sum(f.cost < best.cost * 1.001 for f in fits)

    def free_run(values: Array, state: Array) -> Array:
        full = network.values.copy()
        full[scaling.index] = values
        states = np.concatenate([state, every0[len(state) :]])
        return simulate_segments(kernel, full[None], states[None], t, u, segments.begins)[0]

    stale = np.where(weight > 0.0, free_run(start, state0) - y, np.nan)
    residual = np.where(weight > 0.0, free_run(best.values, best.state) - y, np.nan)
    widened = variance_inflation(residual[seen], network.sigma)
    # Residuals that are not white are worth fewer samples than there are. Without this, model error would
    # drive a parameter that the record does not identify to a bound.
    tempered = GaussianPrior(prior.mean, prior.precision * widened)
    best = fit_parameters(kernel, scaling, network.values, data, best.values, best.state, tempered)
    residual = np.where(weight > 0.0, free_run(best.values, best.state) - y, np.nan)
    covariance = np.asarray(np.linalg.inv(best.normal / widened + prior.precision), dtype=np.float64)
    spread = np.sqrt(np.diag(covariance)[: len(ids)])
    identified = spread / scaling.prior_sd() < UNIDENTIFIABLE_SHARE
    low, high = (scaling.to_values(scaling.to_z(best.values) + s * NORMAL90 * spread) for s in (-1.0, 1.0))
    names = network.sensor_names
    errors = [dict(zip(names, rmse(r), strict=True)) for r in (stale[~seen], residual[~seen], residual[seen])]
    notes = _notes(network, ids, (agree, len(fits)), start, best, identified, u[seen], widened)
    notes += [segments.sentence] if segments.gaps else []
    silent = [name for j, name in enumerate(network.sensor_names) if not (weight[:, j] > 0.0).any()]
    notes += [f"{', '.join(silent)}: no reading in the record, so nothing was fitted to it"] if silent else []
    values = dict(zip(ids, best.values.tolist(), strict=True))
    revision = Revision(
        number=network.revision.number + 1,
        parent=network.digest,
        made_by=options.made_by,
        window_s=(float(t[0]), float(t[rows - 1])),
        held_out_s=(float(t[split]), float(t[end - 1])),
        error_before_K={k: v for k, v in errors[0].items() if np.isfinite(v)},
        error_after_K={k: v for k, v in errors[1].items() if np.isfinite(v)},
        error_fitted_K={k: v for k, v in errors[2].items() if np.isfinite(v)},
        notes=tuple(notes),
    )
    return CommissionResult(
        network=network.with_values(values, revision),
        values=values,
        start=dict(zip(ids, start.tolist(), strict=True)),
        standard_error=dict(zip(ids, (spread * scaling.slope(best.values)).tolist(), strict=True)),
        interval90={name: (float(a), float(b)) for name, a, b in zip(ids, low, high, strict=True)},
        unidentifiable=tuple(name for name, ok in zip(ids, identified, strict=True) if not ok),
        at_bound=tuple(name for name, hit in zip(ids, best.at_bound, strict=True) if hit),
        rmse_before=errors[0],
        rmse_after=errors[1],
        rmse_fitted=errors[2],
        held_out_s=(float(t[split]), float(t[end - 1])),
        covariance=covariance[: len(ids), : len(ids)],
        condition=condition_number(best.normal[: len(ids), : len(ids)]),
        state=best.state,
        evaluations=sum(f.evaluations for f in fits) + best.evaluations,
        notes=tuple(notes),
    )


def weak_prior(scaling: Scaling, values: Array, state: Array, state_sd: float) -> GaussianPrior:
    """Return a prior centred on `values` (q,) and `state` (k,), as wide as `Scaling.prior_sd` and `state_sd` K."""
    sd = np.concatenate([scaling.prior_sd(), np.full(state.size, state_sd)])
    return GaussianPrior(np.concatenate([scaling.to_z(values), state]), np.diag(sd**-2.0))


def _held_out(network: Network, time: Array, inputs: Array, share: float) -> tuple[int, int]:
    """Return the first row of the held-out segment and the row after its last; the record's end where none is
    better.
    """
    spans = np.array([spec.upper - spec.lower for spec in network.inputs.values()])
    beyond = BEYOND * np.where(np.isfinite(spans), spans, np.ptp(inputs, axis=0))

    def part(last: float) -> tuple[int, int]:
        first_s, last_s = (time[0] + x * (time[-1] - time[0]) for x in (last - share, last))
        return int(np.searchsorted(time, first_s)), len(time) if last == 1.0 else int(np.searchsorted(time, last_s))

    for last in np.arange(1.0, share, -0.5 * share):
        first, end = part(float(last))
        inside, rest = inputs[first:end], np.delete(inputs, slice(first, end), axis=0)
        low, high = rest.min(axis=0) - beyond, rest.max(axis=0) + beyond
        if len(inside) and (inside >= low).all() and (inside <= high).all():
            return first, end
    return part(1.0)


def _before_any_input_moves(network: Network, inputs: Array) -> int:
    """Return the number of first rows of inputs (n, c) that show the initial state: 1 to `FIRST_SAMPLES`."""
    first = inputs[:FIRST_SAMPLES]
    width = np.array([spec.upper - spec.lower for spec in network.inputs.values()])
    moved = (np.abs(first - first[0]) > MOVED * np.where(np.isfinite(width), width, 0.0)).any(axis=1)
    return int(np.argmax(moved)) if moved.any() else len(first)


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


def _switched_off(network: Network, at_bound: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters that ended at a bound of their kind which is its default, 0 or 1: their effect is off."""
    specs = {f"{e.name}.{spec.name}": spec for e in network.elements for spec in e.parameter_specs()}
    found = {}
    for name, value in at_bound.items():
        spec = specs[name]
        nearest = min((spec.lower, spec.upper), key=lambda bound: abs(bound - value))
        if (
            spec.default == nearest
            and nearest in (0.0, 1.0)
            and abs(value - nearest) < AT_BOUND * (spec.upper - spec.lower)
        ):
            found[name] = nearest
    return found


def _correlation_time(r: Array) -> float:
    """Return the autocorrelation time of r (n,) in samples, 1 for white noise."""
    spectrum = np.abs(np.fft.rfft(r, 2 * r.size)) ** 2
    correlation = np.fft.irfft(spectrum)[: r.size // 2]
    correlation = correlation / max(correlation[0], 1e-300)
    negative = np.flatnonzero(correlation < 0.05)
    until = int(negative[0]) if negative.size else correlation.size
    return 1.0 + 2.0 * float(correlation[1:until].sum())


def _notes(
    network: Network,
    ids: tuple[str, ...],
    agree: tuple[int, int],
    start: Array,
    best: GaussNewtonFit,
    identified: np.ndarray,
    inputs: Array,
    widened: float,
) -> list[str]:
    notes = []
    if agree[0] < agree[1]:
        notes.append(f"{agree[0]} of {agree[1]} starts reached the best fit; the others ended above it")
    constant = [c for c, column in zip(network.input_columns, inputs.T, strict=True) if np.ptp(column) == 0.0]
    if constant:
        notes.append(f"{', '.join(constant)} did not vary in the record, so their effects are not identifiable")
    unidentified = [name for name, ok in zip(ids, identified, strict=True) if not ok]
    moved = {
        name: f"{a:.4g} to {b:.4g}"
        for name, a, b in zip(ids, start.tolist(), best.values.tolist(), strict=True)
        if name in unidentified and f"{a:.4g}" != f"{b:.4g}"
    }
    if kept := [name for name in unidentified if name not in moved]:
        notes.append(f"the record does not identify {', '.join(kept)}; their values come from the twin file")
    if moved:
        steps = ", ".join(f"{name} ({step})" for name, step in moved.items())
        notes.append(
            f"the record does not identify {steps}; they moved within their prior only, together with other "
            'parameters: status = "fixed" in the twin file keeps the value of the file'
        )
    hit = {name: value for name, value, at in zip(ids, best.values.tolist(), best.at_bound, strict=True) if at}
    absent = _switched_off(network, hit)
    bound = [name for name in hit if name not in absent]
    if bound:
        notes.append(f"{', '.join(bound)} ended on a bound; the model may lack an effect")
    off = [f"{name} = {value:g}" for name, value in absent.items()]
    if off:
        names = ", ".join(off)
        notes.append(f'{names}: the record shows no such effect; status = "fixed" in the twin file ends its fit')
    if widened > 100.0:
        notes.append(f"residuals are far from white (intervals widened {np.sqrt(widened):.0f} times)")
    return notes
