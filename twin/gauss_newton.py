"""Bounded Gauss-Newton with Levenberg damping; the Jacobian is that of lane differences.

Positive parameters whose bounds span a decade or more vary in their logarithm, the others in fractions of their range,
the initial state in kelvin. Bounds are handled by an active set: a variable that sits on a bound and is pushed outward
leaves the step. No parameter goes further at once than is plausible for it. The Gaussian prior holds directions
that the data do not identify, and its share in the result names them.

Source: Nocedal & Wright, Numerical Optimization, 2nd ed., secs. 10.3 and 16.7; Nielsen, IMM-REP-1999-05 for
the damping.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.kernel import LANES, Kernel
from twin.network import Array, Network, TwinFileError
from twin.segments import segment_rows

PRIOR_LOG = 0.5
"""Prior standard deviation of a parameter that varies in its logarithm: a factor of 1.65 either way."""
PRIOR_RANGE = 0.25
"""Prior standard deviation of a parameter that varies linearly, as a fraction of its range."""
REACH = 1.0
"""Longest step, in prior standard deviations of each parameter; beyond it the derivative of a flat direction is no
guide.
"""
PIECE = 600
"""Samples linearised at once."""
_STEP = 1.0e-5


@dataclass(frozen=True)
class Scaling:
    """The map between physical values and the optimiser's variables z, for the named parameters (q,)."""

    ids: tuple[str, ...]
    index: np.ndarray
    log: np.ndarray
    offset: Array
    width: Array
    lower: Array
    upper: Array

    @classmethod
    def of(cls, network: Network, ids: tuple[str, ...]) -> Scaling:
        """Return the scaling of parameters by their bounds.

        Raises
        ------
        TwinFileError
            A parameter is unknown, or has no room between its bounds.
        """
        low, high = network.bounds(ids)
        if (high <= low).any():
            name = ids[int(np.argmax(high <= low))]
            raise TwinFileError(f"{name} has no room between its bounds; take it out of the tunables")
        log = (low > 0.0) & (high >= 10.0 * np.maximum(low, 1e-300))
        offset, width = np.where(log, 0.0, low), np.where(log, 1.0, high - low)
        return cls(ids, network.index(ids), log, offset, width, low, high)

    def to_z(self, values: Array) -> Array:
        """Return physical values (..., q) as z."""
        safe = np.where(self.log, np.maximum(values, 1e-300), 1.0)
        z: Array = np.where(self.log, np.log(safe), (values - self.offset) / self.width)
        return z

    def to_values(self, z: Array) -> Array:
        """Return z (..., q) as physical values, inside the bounds to the last bit."""
        values = np.where(self.log, np.exp(np.where(self.log, z, 0.0)), self.offset + self.width * z)
        clipped: Array = np.clip(values, self.lower, self.upper)
        return clipped

    def slope(self, values: Array) -> Array:
        """Return d value / d z at `values` (q,)."""
        return np.where(self.log, values, self.width)

    def prior_sd(self) -> Array:
        """Return the prior standard deviation (q,) of z."""
        return np.where(self.log, PRIOR_LOG, PRIOR_RANGE)


@dataclass(frozen=True)
class FitData:
    """A record or window, cleaned: time (n,) s, inputs (n, c), measured degC and weight 1/K (n, m).

    `begins` are the rows at which the twin restarts (`twin.segments`). A state is then the node temperatures (s * k,)
    at each of them.
    """

    time: Array
    inputs: Array
    measured: Array
    weight: Array
    begins: tuple[int, ...] = (0,)

    def segments(self) -> tuple[FitData, ...]:
        """Return each segment by itself, up to the first row of the next one, which has no weight."""
        found = []
        for rows in segment_rows(self.begins, len(self.time)):
            r, weight = slice(rows.start, rows.stop + 1), self.weight[rows.start : rows.stop + 1].copy()
            weight[rows.stop - rows.start :] = 0.0
            found.append(FitData(self.time[r], self.inputs[r], self.measured[r], weight))
        return tuple(found)

    def thinned(self, step_s: float) -> FitData:
        """Return about one sample in `step_s`, with the inputs' means until the next one and as much weight in all.

        A descent finds the neighbourhood of its minimum from them at a fraction of the cost.
        """
        period_s = float(np.median(np.diff(self.time))) if len(self.time) > 1 else 0.0
        every = int(step_s / period_s + 1e-9) if period_s > 0.0 else 1
        if every < 2:
            return self
        kept, begins = [], [0]
        for rows in segment_rows(self.begins, len(self.time)):
            kept.append(np.arange(rows.start, rows.stop, every))
            begins.append(begins[-1] + len(kept[-1]))
        first = np.concatenate(kept)
        held = np.diff(self.time, append=self.time[-1])[:, None]
        length = np.add.reduceat(held, first)
        means = np.add.reduceat(self.inputs * held, first) / np.where(length > 0.0, length, 1.0)
        inputs = np.where(length > 0.0, means, self.inputs[first])
        weight = self.weight[first] * np.sqrt(every)
        return FitData(self.time[first], inputs, self.measured[first], weight, tuple(begins[:-1]))


@dataclass(frozen=True)
class GaussianPrior:
    """A Gaussian prior of [parameters z, state K]: mean (q + k,), precision (q + k, q + k)."""

    mean: Array
    precision: Array


@dataclass(frozen=True)
class Linearisation:
    """Noise-weighted residuals and their derivatives by q quantities.

    Attributes
    ----------
    readings
        (n, m) degC at the centre.
    end
        State at the last sample.
    jtj
        (q, q) product J'J.
    jtr
        (q,) gradient of half the squares.
    sse
        (m,) weighted squares per sensor.
    """

    readings: Array
    end: Array
    jtj: Array
    jtr: Array
    sse: Array


@dataclass(frozen=True)
class GaussNewtonFit:
    """Result of one descent.

    Attributes
    ----------
    v
        (q + s * k,) the minimum: [z, temperatures at the restarts].
    values
        Physical values (q,).
    state
        State at the first sample of each segment.
    data
        Residuals linearised at the minimum.
    cost
        Weighted squares plus prior.
    at_bound
        (q,) bool.
    evaluations
        Linearisations made.
    """

    v: Array
    values: Array
    state: Array
    data: Linearisation
    cost: float
    at_bound: np.ndarray
    evaluations: int

    @property
    def sse(self) -> Array:
        """Return the weighted squares per sensor (m,)."""
        return self.data.sse

    @property
    def normal(self) -> Array:
        """Return J'J of the data alone (q + s * k, q + s * k), in z and K."""
        return self.data.jtj


def linearise(kernel: Kernel, parameters: Array, state: Array, steps: Array, data: FitData) -> Linearisation:
    """Return normal equations by forward differences across lanes: row 0 is the centre, row a differs by steps[a - 1].

    Parameters
    ----------
    kernel
        The compiled network.
    parameters
        (1 + q, p) full vectors.
    state
        1 + q states.
    steps
        (q,) size of each row's difference.
    data
        Samples and weights.
    """
    n, m = data.measured.shape
    q = steps.size
    jtj, jtr, sse, readings = np.zeros((q, q)), np.zeros(q), np.zeros(m), np.empty((n, m))
    # In pieces, each beginning with the last sample of the one before it, so that a record of any length fits
    # in the cache.
    for first in range(0, max(n - 1, 1), PIECE):
        last = min(first + PIECE + 1, n)
        traced, state = kernel.trace(parameters, state, data.time[first:last], data.inputs[first:last])
        new = slice(first + (first > 0), last)
        lanes = np.moveaxis(traced, 0, 2)[new.start - first :]
        weight = data.weight[new]
        centre = lanes[:, :, 0]
        readings[new] = centre
        difference = lanes[:, :, 1:] - centre[:, :, None]
        difference *= weight[:, :, None]
        jacobian = difference.reshape(-1, q)
        residual = (centre - data.measured[new]) * weight
        jtj += jacobian.T @ jacobian
        jtr += residual.ravel() @ jacobian
        sse += np.einsum("ij,ij->j", residual, residual)
    return Linearisation(readings, state[0].copy(), jtj / np.outer(steps, steps), jtr / steps, sse)


class FitProblem:
    """Weighted squares of a record as a function of v = [z (q,), node temperatures at each restart (s * k,)].

    Parameters
    ----------
    kernel, scaling
        The compiled network and the scaling of the parameters to fit.
    base
        Full parameter vector (p,); entries of `scaling.index` are replaced.
    data
        Samples and weights.
    state
        (s * k,) at the restarts. For a record in one segment also a full state at the first sample; its entries beyond
        the k temperatures (`twin.kernel.state_layout`) are taken as known.

    Raises
    ------
    TwinFileError
        There are more tunables and nodes than lanes of the kernel.
    """

    def __init__(self, kernel: Kernel, scaling: Scaling, base: Array, data: FitData, state: Array) -> None:
        self.q, self.k = len(scaling.ids), len(kernel.network.nodes)
        if self.q + self.k >= LANES:
            raise TwinFileError(
                f"{self.q} tunables and {self.k} nodes are too many for one fit; at most {LANES - 1} together"
            )
        self.kernel, self.scaling, self.data = kernel, scaling, data
        self._pieces = data.segments()
        states = len(self._pieces) * self.k
        self.low = np.concatenate([scaling.to_z(scaling.lower), np.full(states, -np.inf)])
        self.high = np.concatenate([scaling.to_z(scaling.upper), np.full(states, np.inf)])
        self._steps = np.concatenate([np.full(self.q, _STEP), np.full(states, 1e-2)])
        self._full = np.tile(base, (1 + self.q + self.k, 1))
        self._rest = state[states:] if len(self._pieces) == 1 else state[:0]
        self._reach = np.concatenate([REACH * scaling.prior_sd(), np.full(states, np.inf)])
        self._own_row, self._own_column = np.arange(1, 1 + self.q), np.arange(self.q)
        self.evaluations = 0

    def linearise(self, v: Array) -> Linearisation:
        """Return residuals and their derivatives at v (q + s * k,)."""
        steps = self._lanes(v)
        if len(self._pieces) == 1:
            return linearise(self.kernel, self._full, self._begun(v, 0, self._rest), steps, self.data)
        found, rest = [], self._rest
        for i, piece in enumerate(self._pieces):
            found.append(linearise(self.kernel, self._full, self._begun(v, i, rest), steps, piece))
            rest = found[-1].end[self.k :]
        jtj, jtr = np.zeros((v.size, v.size)), np.zeros(v.size)
        for i, each in enumerate(found):
            own = self._own(i)
            jtj[np.ix_(own, own)] += each.jtj
            jtr[own] += each.jtr
        rows = segment_rows(self.data.begins, len(self.data.time))
        readings = np.concatenate([e.readings[: r.stop - r.start] for e, r in zip(found, rows, strict=True)])
        return Linearisation(readings, found[-1].end, jtj, jtr, np.sum([each.sse for each in found], axis=0))

    def jacobian(self, v: Array) -> Array:
        """Return derivatives (n, m, q + k) of the readings at v (q + k,), unweighted, of a record in one segment."""
        return self.readings_and_derivatives(v)[:, :, 1:]

    def readings_and_derivatives(self, v: Array) -> Array:
        """Return readings and their derivatives (n, m, 1 + q + k) at v (q + k,), of a record in one segment."""
        steps = self._lanes(v)
        traced, _ = self.kernel.trace(self._full, self._begun(v, 0, self._rest), self.data.time, self.data.inputs)
        found = np.moveaxis(traced, 0, 2).copy()
        found[:, :, 1:] -= found[:, :, :1]
        found[:, :, 1:] /= steps
        return found

    def _own(self, i: int) -> np.ndarray:
        """Return the positions in v on which segment i depends."""
        return np.concatenate([np.arange(self.q), self.q + i * self.k + np.arange(self.k)])

    def _lanes(self, v: Array) -> Array:
        """Set parameters that differ from v by a step each; return the steps (q + k,), the last k of temperatures."""
        self.evaluations += 1
        one = slice(0, self.q + self.k)
        steps = np.where(v[one] + self._steps[one] > self.high[one], -self._steps[one], self._steps[one])
        rows = np.repeat(v[None, : self.q], 1 + self.q + self.k, axis=0)
        rows[self._own_row, self._own_column] += steps[: self.q]
        self._full[:, self.scaling.index] = self.scaling.to_values(rows)
        return steps

    def _begun(self, v: Array, i: int, rest: Array) -> Array:
        """Return states (1 + q + k, ...) of segment i, the last k rows a step away each; `rest` is the other memory."""
        own = v[self.q + i * self.k : self.q + (i + 1) * self.k]
        rows = np.repeat(np.concatenate([own, rest])[None], 1 + self.q + self.k, axis=0)
        rows[1 + self.q :, : self.k] += np.diag(self._steps[self.q : self.q + self.k])
        return rows

    def minimise(
        self,
        v: Array,
        prior: GaussianPrior,
        *,
        first: Linearisation | None = None,
        held: np.ndarray | None = None,
        most: int = 40,
        tolerance: float = 1e-6,
    ) -> GaussNewtonFit:
        """Minimise squares plus prior, from v (q + s * k,).

        Parameters
        ----------
        v
            Start.
        prior
            Gaussian prior of v.
        first
            Result of `linearise` at v, if it is known.
        held
            (q + s * k,) bool, variables that stay.
        most
            Largest number of linearisations.
        tolerance
            Relative decrease of the cost below which the descent ends.
        """
        low, high, q = self.low, self.high, self.q
        open_ = np.ones(v.size, dtype=bool) if held is None else ~held

        def total(v: Array, out: Linearisation) -> float:
            away = v - prior.mean
            return float(out.sse.sum() + away @ prior.precision @ away)

        out = first or self.linearise(v)
        cost = total(v, out)
        damping, growth = 1e-3, 2.0
        for _ in range(most - 1):
            hessian = out.jtj + prior.precision
            gradient = out.jtr + prior.precision @ (v - prior.mean)
            free = open_ & ~(((v <= low) & (gradient > 0.0)) | ((v >= high) & (gradient < 0.0)))
            box = np.maximum(low - v, -self._reach), np.minimum(high - v, self._reach)
            step = _bounded_step(hessian, gradient, free, damping, *box)
            predicted = -float(2.0 * gradient @ step + step @ hessian @ step)
            if not np.isfinite(predicted):
                break
            if predicted <= tolerance * max(cost, 1e-300) * 1e-2:
                if (np.abs(step) < self._reach).all() or damping > 1e12:
                    break
                # Variables held at their reach one after the other need not add up to a descent; a shorter step does.
                damping, growth = damping * growth, growth * 2.0
                continue
            trial = v + step
            new_out = self.linearise(trial)
            new_cost = total(trial, new_out)
            ratio = (cost - new_cost) / predicted
            if new_cost < cost:
                done = cost - new_cost < tolerance * cost
                v, cost, out = trial, new_cost, new_out
                damping, growth = damping * max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), 2.0
                if done and ratio > 0.1:
                    break
            else:
                damping, growth = damping * growth, growth * 2.0
                if damping > 1e12:
                    break
        at_bound = (v[:q] <= low[:q] + 1e-9) | (v[:q] >= high[:q] - 1e-9)
        state = np.concatenate([v[q:], self._rest])
        return GaussNewtonFit(v, self.scaling.to_values(v[:q]), state, out, cost, at_bound, self.evaluations)


def fit_parameters(
    kernel: Kernel,
    scaling: Scaling,
    base: Array,
    data: FitData,
    values: Array,
    state: Array,
    prior: GaussianPrior,
) -> GaussNewtonFit:
    """Minimise weighted squares plus prior over the scaled parameters and the initial state.

    Parameters
    ----------
    kernel, scaling
        The compiled network and the scaling of the parameters to fit.
    base
        Full parameter vector (p,); entries of `scaling.index` are replaced.
    data
        Samples and weights.
    values, state
        Start: (q,) and a state.
    prior
        Gaussian prior of both.
    """
    problem = FitProblem(kernel, scaling, base, data, state)
    temperatures = state[: len(data.begins) * problem.k]
    v = np.clip(np.concatenate([scaling.to_z(values), temperatures]), problem.low, problem.high)
    return problem.minimise(v, prior)


def _bounded_step(hessian: Array, gradient: Array, free: np.ndarray, damping: float, low: Array, high: Array) -> Array:
    """Return a damped step inside [low, high]; variables that would leave are put on the bound and solved around."""
    diagonal = np.diag(hessian)
    scale = damping * np.maximum(diagonal, 1e-12 * max(diagonal.max(), 1e-300))
    damped = hessian + np.diag(scale)
    if free.all():
        step = np.asarray(-np.linalg.solve(damped, gradient), dtype=np.float64)
        if not ((step < low) | (step > high)).any():
            return step
    step = np.zeros_like(gradient)
    free = free.copy()
    for _ in range(gradient.size):
        if not free.any():
            break
        rows = damped[free]
        pull = gradient[free] + rows[:, ~free] @ step[~free]
        step[free] = -np.linalg.solve(rows[:, free], pull)
        out = free & ((step < low) | (step > high))
        if not out.any():
            break
        step[out] = np.clip(step[out], low[out], high[out])
        free &= ~out
    return np.clip(step, low, high)


def fit_initial_state(
    kernel: Kernel, base: Array, state: Array, data: FitData, sd: Array | float, most: int = 3
) -> Array:
    """Fit the initial state to `data` at fixed parameters, with a prior of `sd` K around the temperatures of `state`.

    One step is exact for a linear network; the others are for elements that are not.
    """
    k = len(kernel.network.nodes)
    weight = np.broadcast_to(np.asarray(sd, dtype=np.float64), (k,)) ** -2.0
    steps = np.full(k, 1e-2)
    best = state.copy()
    full, rows = np.tile(base, (1 + k, 1)), np.tile(state, (1 + k, 1))
    for _ in range(most):
        rows[:, :k] = best[:k] + np.vstack([np.zeros(k), np.diag(steps)])
        out = linearise(kernel, full, rows, steps, data)
        step = np.linalg.solve(out.jtj + np.diag(weight), -out.jtr - weight * (best[:k] - state[:k]))
        best[:k] += step
        if np.abs(step).max() < 1e-6:
            break
    return best
