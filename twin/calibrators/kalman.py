"""Joint state and parameter Kalman filter: an estimate with every sample, a calibration with every window.

The extended filter of Jazwinski (Stochastic Processes and Filtering Theory, 1970, sec. 8.3) on [parameters w, node
temperatures K]. The model is linear in the temperatures and mildly not in the parameters. So its derivatives, lane
differences along the predicted trajectory, are renewed every RENEW_S only; in between a sample costs a scalar update
per sensor.

A naive joint filter diverges with nine tunables. Hence parameters are in units of their plausible range, held inside
their bounds by a transformation w. The commissioned values are an informative prior, followed by a small random walk.
Innovations that are larger than expected widen the parameters' covariance again, segment by segment and only as far as
needed.
Some windows the filter cannot follow even so: a change is too slow for single innovations, or so large that a
derivative at the wrong place misleads. They are fitted by least squares, from the filter's estimate before the window,
and the filter continues from there.

The results compared with the other calibrators are defined alike. `tracked` runs free from the parameters and the
state at the end of the last completed window. `fitted` is the window simulated again with the parameters at its end,
from a re-estimated initial state. The filtered readings have seen the sample that they describe; they are offered
with their standard deviation and belong in no table of predictions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.calibrators.assimilate import assimilate
from twin.calibrators.base import Calibration, FilteredReadings, Window, from_json, normalised_misfit, to_json
from twin.calibrators.identifiability import window_information
from twin.calibrators.posterior import (
    ParameterBelief,
    WindowPosterior,
    WindowPrior,
    fit_window,
    limit_covariance,
    window_data,
)
from twin.calibrators.results import CalibrationReport, WindowFit, fitted_calibration
from twin.calibrators.structural_error import error_size, persistent_error_covariance, sample_sd
from twin.gauss_newton import FitProblem, Linearisation, Scaling
from twin.kernel import Kernel
from twin.network import Array, Network

RENEW_S = 30.0
"""Length of a filter segment between linearisations, s."""
QUIET_SHARE = 0.02
"""Random walk of the parameters in 600 s, as a share of the plausible range."""
WALK_J = 10.0
"""Random walk of each volume's heat in 60 s, J: the effects that the model leaves out."""
FIRST_STATE_K = 0.05
LEAST_STATE_K = 0.02
WIDEST_STATE_K = 5.0
"""Standard deviation of a temperature, K: when the filter starts; given the carried state, at least; and at most."""
SURPRISE = 1.3
"""Root mean square of a segment's normalised innovations above which the parameters' covariance is widened."""
OPENING = 0.3
"""Widening per unit of excess, as a share of the plausible range."""
_ARRAYS = ("centre", "lanes", "deviation", "inputs", "covariance")
_NUMBERS = ("began", "time", "surprise", "count")
_INSIDE = 0.999
_STEP = 1e-4
_STATE_STEP = 1e-2
"""Share of the half width of its bounds up to which a parameter is mapped; steps of the lane differences of w, and of
the state, K."""


class BoundedTransform:
    """The map between z inside its bounds and w without any: z = mid + half tanh((w - mid) / half), slope 1 in the
    middle.
    """

    def __init__(self, scaling: Scaling) -> None:
        low, high = scaling.to_z(scaling.lower), scaling.to_z(scaling.upper)
        self.mid, self.half = 0.5 * (low + high), 0.5 * (high - low)
        reach = self.half * np.arctanh(_INSIDE)
        self.limits = self.mid - reach, self.mid + reach

    def to_w(self, z: Array) -> Array:
        """Return z as w."""
        inside = np.clip((z - self.mid) / self.half, -_INSIDE, _INSIDE)
        w: Array = self.mid + self.half * np.arctanh(inside)
        return w

    def to_z(self, w: Array) -> Array:
        """Return w as z."""
        z: Array = self.mid + self.half * np.tanh((w - self.mid) / self.half)
        return z

    def slope(self, w: Array) -> Array:
        """Return dz / dw."""
        slope: Array = 1.0 - np.tanh((w - self.mid) / self.half) ** 2
        return slope


@dataclass
class _FilterSegment:
    """State of the filter inside a segment of RENEW_S.

    Attributes
    ----------
    centre
        (N,) [w, temperatures] around which the segment was linearised, at its beginning.
    lanes
        (1 + N, s) states of the differing trajectories at the last sample.
    deviation, covariance
        (N,) estimate of the beginning less `centre`, and its (N, N) covariance.
    began, time
        Times of the beginning and of the last sample, s.
    inputs
        (c,) inputs held now.
    surprise, count
        Sum of the normalised innovations squared so far, and their number.
    """

    centre: Array
    lanes: Array
    deviation: Array
    began: float
    time: float
    inputs: Array
    covariance: Array
    surprise: float = 0.0
    count: int = 0


class KalmanFilter:
    """Kalman filter as a calibrator; satisfies `Calibrator` and `SampleFilter`. Deterministic."""

    name = "kalman"

    def __init__(self, network: Network, tunables: str | tuple[str, ...] = "nine") -> None:
        self.network = network
        self.ids = network.tunables(tunables)
        self.kernel = Kernel(network, self.ids)
        self._scaling = Scaling.of(network, self.ids)
        self._bounded = BoundedTransform(self._scaling)
        self._wide = self._scaling.prior_sd()
        q, k = len(self.ids), len(network.nodes)
        self._steps = np.concatenate([np.full(q, _STEP), np.full(k, _STATE_STEP)])
        self._parameters = ParameterBelief(network, self._scaling)
        capacitance = network.index(f"{node}.capacitance" for node in network.nodes)
        self._capacitance = np.maximum(network.values[capacitance], 1.0)
        self._piece: _FilterSegment | None = None

    def follow(self, time: Array, inputs: Array, measured: Array, read: np.ndarray, state: Array) -> FilteredReadings:
        """Filter samples, in order; `state` counts at the very first one only, and all inputs count as read."""
        filtered, spread = np.empty_like(measured), np.empty_like(measured)
        at = 0
        if self._piece is None:
            q, k = len(self.ids), len(self.network.nodes)
            covariance = np.diag(np.full(q + k, FIRST_STATE_K**2))
            covariance[:q, :q] = self._parameters.covariance
            w = self._bounded.to_w(self._parameters.mean)
            self._piece = self._new_piece(w, state, float(time[0]), inputs[0], covariance)
        while at < time.size:
            piece = self._piece
            if piece.time >= piece.began + RENEW_S:
                self._piece = piece = self._renew(piece)
            until = int(np.searchsorted(time, piece.began + RENEW_S)) + 1
            rows = slice(at, min(max(until, at + 1), time.size))
            self._filter(piece, time[rows], inputs[rows], measured[rows], filtered[rows], spread[rows])
            at = rows.stop
        return FilteredReadings(filtered, spread)

    def restart(self) -> None:
        """Forget the temperatures; parameters continue from the end of the last window."""
        self._piece = None

    def _filter(self, piece: _FilterSegment, time: Array, inputs: Array, measured: Array, *out: Array) -> None:
        """Filter samples of one segment."""
        q = len(self.ids)
        rows = piece.centre + np.vstack([np.zeros(self._steps.size), np.diag(self._steps)])
        full = np.tile(self.network.values, (len(rows), 1))
        full[:, self._scaling.index] = self._values(rows[:, :q])
        times, drive = np.concatenate([[piece.time], time]), np.vstack([piece.inputs, inputs])
        traced, piece.lanes = self.kernel.trace(full, piece.lanes, times, drive)
        lanes = np.moveaxis(traced, 0, 2)[1:]
        centre = np.ascontiguousarray(lanes[:, :, 0])
        jacobian = (lanes[:, :, 1:] - centre[:, :, None]) / self._steps
        gap = np.diff(times)
        variance = sample_sd(self.network, np.where(gap > 0.0, gap, np.inf)) ** 2
        piece.time, piece.inputs = float(time[-1]), inputs[-1].copy()
        total, count = assimilate(jacobian, centre, measured, variance, piece.deviation, piece.covariance, *out)
        piece.surprise += total
        piece.count += count

    def _values(self, w: Array) -> Array:
        return self._scaling.to_values(self._bounded.to_z(w))

    def _new_piece(self, w: Array, state: Array, time: float, inputs: Array, covariance: Array) -> _FilterSegment:
        k = len(self.network.nodes)
        lanes = np.tile(state, (1 + self._steps.size, 1))
        lanes[1 + len(w) :, :k] += np.diag(np.full(k, _STATE_STEP))
        centre = np.concatenate([w, state[:k]])
        return _FilterSegment(centre, lanes, np.zeros(centre.size), time, time, inputs.copy(), covariance)

    def _now(self, piece: _FilterSegment) -> tuple[Array, Array, Array]:
        """Return parameters w, the state at the last sample, and its derivative (N, N) by the segment's beginning."""
        q, k = len(self.ids), len(self.network.nodes)
        transition = np.eye(q + k)
        transition[q:] = ((piece.lanes[1:, :k] - piece.lanes[0, :k]) / self._steps[:, None]).T
        state = piece.lanes[0].copy()
        state[:k] += transition[q:] @ piece.deviation
        return piece.centre[:q] + piece.deviation[:q], state, transition

    def _renew(self, piece: _FilterSegment) -> _FilterSegment:
        """Linearise again around the estimate, with the process noise of the segment that ends."""
        k = len(self.network.nodes)
        w, state, transition = self._now(piece)
        span = piece.time - piece.began
        walk = (QUIET_SHARE * self._wide) ** 2 * span / 600.0
        drift = (WALK_J / self._capacitance) ** 2 * span / 60.0
        surprise = float(np.sqrt(piece.surprise / piece.count)) if piece.count else 0.0
        if surprise > SURPRISE:
            walk = walk + (min(OPENING * (surprise - SURPRISE), 1.0) * self._wide) ** 2
            drift = drift + (FIRST_STATE_K * surprise) ** 2
        covariance = transition @ piece.covariance @ transition.T
        covariance += np.diag(np.concatenate([walk, drift]))
        widest = np.concatenate([self._parameters.widest(self._bounded.to_z(w)), np.full(k, WIDEST_STATE_K)])
        factor = np.minimum(widest / np.sqrt(np.diag(covariance)), 1.0)
        covariance = 0.5 * (covariance + covariance.T) * np.outer(factor, factor)
        return self._new_piece(np.clip(w, *self._bounded.limits), state, piece.time, piece.inputs, covariance)

    def calibrate(self, window: Window) -> Calibration:
        """Return the filter's estimate at the end of the window, after filtering samples that it has not seen."""
        behind = 0 if self._piece is None else int(np.searchsorted(window.time, self._piece.time, side="right"))
        if behind < window.time.size:
            rows = slice(behind, None)
            samples = (window.time[rows], window.inputs[rows], window.measured[rows], window.read[rows])
            self.follow(*samples, window.state)
        cost, v, fitted = self._fitted(window)
        missed = normalised_misfit(window, self.network.sigma)
        again = self._again(window, missed) if cost > SURPRISE and missed > SURPRISE else None
        if again is not None and np.sqrt(again.fit.sse.sum()) < np.sqrt(fitted.sse.sum()):
            self._restart(window, again)
            report = again.report(self._scaling)
            report = replace(report, flags=("filter started again from a fit of the window", *report.flags))
            cost, v, fitted = float(np.sqrt(again.chi)), again.fit.v, again.fit.data
        else:
            report = self._report(window, v, fitted)
        self._remember()
        assert self._piece is not None
        w, end, _ = self._now(self._piece)
        start = window.state.copy()
        start[: v.size - len(self.ids)] = v[len(self.ids) :]
        result = WindowFit(self._values(w), start, fitted.readings, end, cost, evaluations=2 * (1 + v.size))
        return fitted_calibration(self.network, window, self.ids, result, report)

    def _again(self, window: Window, missed: float) -> WindowPosterior | None:
        """Fit a window that the filter could not follow by least squares, with the prior from before it; None if
        that fails.
        """
        opened = min(OPENING * (missed - 1.0), 1.0)
        belief = self._parameters
        covariance = belief.covariance + np.diag((opened * self._wide) ** 2)
        weight, noise = belief.weight(window)
        prior = WindowPrior(belief.mean, covariance, window.state)
        done = fit_window(self.kernel, self._scaling, weight, window, prior, noise=noise)
        if not (np.isfinite(done.fit.cost) and np.isfinite(done.covariance).all()):
            return None
        return replace(done, covariance=belief.limited(done.covariance, done.fit.v[: len(self.ids)]))

    def _restart(self, window: Window, done: WindowPosterior) -> None:
        """Restart the filter from a fit of the window."""
        q, k = len(self.ids), len(self.network.nodes)
        w = np.clip(self._bounded.to_w(done.fit.v[:q]), *self._bounded.limits)
        slope = self._bounded.slope(w)
        covariance = np.diag(np.full(q + k, FIRST_STATE_K**2))
        covariance[:q, :q] = done.covariance / np.outer(slope, slope)
        end = float(window.time[-1])
        self._piece = self._new_piece(w, done.fit.data.end, end, window.inputs[-1], covariance)

    def _remember(self) -> None:
        """Store the parameters and their covariance at the end of a window, in z."""
        assert self._piece is not None
        q = len(self.ids)
        w = self._now(self._piece)[0]
        slope = self._bounded.slope(w)
        self._parameters.mean = self._bounded.to_z(w)
        self._parameters.covariance = self._piece.covariance[:q, :q] * np.outer(slope, slope)

    def _report(self, window: Window, v: Array, fitted: Linearisation) -> CalibrationReport:
        """Return the report, after the effect of the twin's structural error was added to the filter's covariance."""
        assert self._piece is not None
        q, scaling = len(self.ids), self._scaling
        w = self._now(self._piece)[0]
        values = self._values(w)
        info = window_information(fitted.jtj, self._wide)
        names = [i for i, hit in zip(self.ids, info.unidentifiable, strict=True) if hit]
        bounded, slope = self._bounded.slope(w), scaling.slope(values)
        whole = self._piece.covariance
        whole[:q, :q] += self._structural_error(window, v) / np.outer(bounded, bounded)
        widest = np.concatenate(
            [self._parameters.widest(self._bounded.to_z(w)) / bounded, np.full(len(whole) - q, np.inf)]
        )
        self._piece.covariance = limit_covariance(whole, widest)
        known = self._piece.covariance[:q, :q] * np.outer(bounded, bounded)
        return CalibrationReport(
            covariance=known * np.outer(slope, slope),
            flags=tuple(f"{i} is not identifiable by itself: its value comes from earlier windows" for i in names),
            window_errors=info.window_errors(scaling, values),
            condition=info.condition,
        )

    def _structural_error(self, window: Window, v: Array) -> Array:
        """Return the covariance (q, q) in z that the twin's structural error in a window adds to the parameters.

        The filter's gain over the window is that of a fit with the same prior and weights.
        """
        q, belief = len(self.ids), self._parameters
        data = window_data(window, belief.weight(window)[0])
        problem = FitProblem(self.kernel, self._scaling, window.parameters, data, window.state)
        precision = problem.linearise(v).jtj
        precision[:q, :q] += np.linalg.inv(belief.covariance)
        precision[q:, q:] += np.eye(v.size - q) * max(window.error_K, LEAST_STATE_K) ** -2
        gain = np.asarray(np.linalg.inv(precision))
        found: Array = persistent_error_covariance(problem, v, gain, error_size(window, self.network))[:q, :q]
        return found

    def _problem(self, window: Window) -> FitProblem:
        data = window_data(window, self.network.sigma)
        return FitProblem(self.kernel, self._scaling, window.parameters, data, window.state)

    def _fitted(self, window: Window) -> tuple[float, Array, Linearisation]:
        """Simulate the window with the present parameters; return misfit in units of noise, start v, and linearisation.

        The state at the beginning is estimated anew; for a linear network one step does it.
        """
        assert self._piece is not None
        q, problem = len(self.ids), self._problem(window)
        values = self._values(self._now(self._piece)[0])
        v = np.concatenate([self._scaling.to_z(values), window.state[: len(self.network.nodes)]])
        first = problem.linearise(v)
        precision = np.eye(v.size - q) * max(window.error_K, LEAST_STATE_K) ** -2
        v[q:] -= np.linalg.solve(first.jtj[q:, q:] + precision, first.jtr[q:])
        fitted = problem.linearise(v)
        count = max(int((problem.data.weight > 0.0).sum()), 1)
        return float(np.sqrt(fitted.sse.sum() / count)), v, fitted

    def state(self) -> dict[str, Any]:
        """Return everything needed to continue, as plain data."""
        piece = self._piece
        return {
            "mean": self._parameters.mean.tolist(),
            "covariance": self._parameters.covariance.tolist(),
            "piece": None
            if piece is None
            else {k: to_json(getattr(piece, k)) for k in _ARRAYS} | {k: getattr(piece, k) for k in _NUMBERS},
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`."""
        self._parameters.mean, self._parameters.covariance = from_json(state["mean"]), from_json(state["covariance"])
        self._piece, piece = None, state["piece"]
        if piece is not None:
            entries: dict[str, Any] = {k: from_json(piece[k]) for k in _ARRAYS}
            self._piece = _FilterSegment(**entries, **{k: piece[k] for k in _NUMBERS})
