"""Least-squares problem of tunables, initial state and effects on a record without a healthy one.

The squares of the free run count slow misfit in full. Weighting by the residual's spectrum would trade a slow error for
a better fit of fast effects. The spectrum enters the likelihood of a fit (`likelihood`) and the standard deviations of
its sizes. The prior is wide, as nothing was commissioned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin.discovery.growing.likelihood import Spectrum, cosines, judged
from twin.discovery.growing.superset.candidate_superset import CandidateSuperset
from twin.discovery.records.grid import centred
from twin.discovery.scoring.search import Entry
from twin.gauss_newton import Scaling
from twin.kernel import FEW_LANES
from twin.network import Array

STATE_SD_K = 1.0
"""Standard deviation, K, of the initial temperatures given the first readings."""
REACH, REACH_SIZE = 1.0, 2.0
"""Longest step of a tunable, in standard deviations of its prior, and of an effect, relative to its size."""
_STEP = 1.0e-4
_STATE_STEP = 1.0e-2
_SIZE_STEP = 1.0e-3
"""Steps of the differences: of z, of the state, K, and of a size, in typical sizes."""


@dataclass(frozen=True)
class SampledRecord:
    """Record at its own stamps: time (n,) s, inputs (n, c) without gaps, measured (n, m) degC or NaN, sigma (m,) K.

    With `at_rest` each row is a steady state and `time` is its number. `means`: the readings are means over bins that
    begin at `time`; their samples lie on average `centre` steps later.
    """

    time: Array
    inputs: Array
    measured: Array
    sigma: Array
    at_rest: bool = False
    means: bool = False
    centre: float = 0.5

    @property
    def span_s(self) -> float:
        """Return the time from the first to the last sample, s."""
        return float(self.time[-1] - self.time[0])

    def without(self, rows: np.ndarray) -> SampledRecord:
        """Return the record without the readings of some rows."""
        return replace(self, measured=np.where(rows[:, None], np.nan, self.measured))


@dataclass(frozen=True)
class GrowthFit:
    """Fit of one hypothesis.

    Attributes:
        problem, v: (count,) the minimum of its squares.
        entries: effects with sizes. values: (p,) of the network. state: (k,) initial, degC.
        residual: (n, m) K measured minus simulated, NaN where nothing was measured. spectrum: of the residual.
        cost: -2 log likelihood plus the prior's part. at_bound: ids of tunables on a bound.
    """

    problem: GrowthProblem
    v: Array

    entries: tuple[Entry, ...]
    values: Array
    state: Array
    residual: Array
    spectrum: Spectrum
    cost: float
    at_bound: tuple[str, ...]

    @property
    def rms(self) -> Array:
        """Return the RMSE (m,), K, per sensor; NaN for one without readings."""
        count = np.isfinite(self.residual).sum(axis=0)
        mean = np.nansum(self.residual**2, axis=0) / np.maximum(count, 1)
        root: Array = np.sqrt(np.where(count > 0, mean, np.nan))
        return root

    @property
    def sizes(self) -> Array:
        return np.array([e.size for e in self.entries])

    @cached_property
    def slopes(self) -> Array:
        """Return the derivatives (n, m, q + k + e) of the readings, which cost a simulation for each variable."""
        around = self.problem.readings(self.problem.around(self.v))
        return self.problem.slopes(self.v, around[0], around[1:])

    @property
    def precision(self) -> Array:
        """Return the precision (count, count) of the prior."""
        return self.problem.precision

    @cached_property
    def deviations(self) -> Array:
        """Return the standard deviations (e,) of the sizes."""
        p = self.problem
        white = Spectrum.white(p.samples.sigma, len(p.samples.time))
        j = p.whitened(self.slopes, white)
        inverse = np.linalg.pinv(j.T @ j + p.precision, rcond=1e-13, hermitian=True)
        # What is left is not white, so the squares' own covariance would be too sure.
        coloured = j * (self.spectrum.roots / p.samples.sigma).reshape(-1, 1)
        sd = np.sqrt(np.maximum(np.diag(inverse @ (coloured.T @ coloured + p.precision) @ inverse), 0.0))
        return sd[p.q + p.k :] * p.scales


class GrowthProblem:
    """Fit of some effects to a record; `v` is [tunables z - z0 (q,), state - state0 (k,), sizes over scales (e,)].

    Args:
        entries: effects, whose sizes are start point and scale.
    """

    def __init__(
        self, superset: CandidateSuperset, samples: SampledRecord, ids: tuple[str, ...], entries: tuple[Entry, ...] = ()
    ) -> None:
        self.superset, self.samples, self.ids, self.entries = superset, samples, ids, entries
        network = self.network = superset.original
        self.model = superset.model(entries)
        self.scaling = Scaling.of(network, ids)
        self.q, self.k, self.e = len(ids), 0 if samples.at_rest else len(network.nodes), len(entries)
        self.z0 = self.scaling.to_z(network.values[self.scaling.index])
        still = int(np.argmax((samples.inputs != samples.inputs[0]).any(axis=1)))
        self.state0 = network.initial_state(samples.measured[: min(max(still, 3), 10)])[: self.k]
        self.present = np.isfinite(samples.measured)
        self.scales = np.array([max(abs(x.size), 1e-12) for x in entries])
        self.low = np.concatenate(
            [
                self.scaling.to_z(self.scaling.lower) - self.z0,
                np.full(self.k, -20.0),
                [x.candidate.lower / s for x, s in zip(entries, self.scales, strict=True)],
            ]
        )
        self.high = np.concatenate(
            [
                self.scaling.to_z(self.scaling.upper) - self.z0,
                np.full(self.k, 20.0),
                [x.candidate.upper / s for x, s in zip(entries, self.scales, strict=True)],
            ]
        )
        sd = np.concatenate([self.scaling.prior_sd(), np.full(self.k, STATE_SD_K)])
        self.precision = np.diag(np.concatenate([sd**-2.0, np.zeros(self.e)]))
        self.reach = np.concatenate(
            [REACH * self.scaling.prior_sd(), np.full(self.k, 5.0), np.full(self.e, REACH_SIZE)]
        )
        self.steps = np.concatenate([np.full(self.q, _STEP), np.full(self.k, _STATE_STEP), np.full(self.e, _SIZE_STEP)])

    @cached_property
    def kinds(self) -> frozenset[str]:
        """Return the costly kinds of elements that the effects change, which name the problem's kernel."""
        return self.superset.specialised.kinds(x.candidate for x in self.entries)

    def with_entries(self, entries: tuple[Entry, ...], samples: SampledRecord | None = None) -> GrowthProblem:
        """Return the problem of other effects, or of another record."""
        return GrowthProblem(self.superset, samples or self.samples, self.ids, entries)

    def start(self, like: GrowthFit | None = None) -> Array:
        """Return the start point: the network's own values, or those of another fit; effects at the given sizes."""
        v = np.zeros(self.q + self.k + self.e)
        if like is not None:
            v[: self.q] = self.scaling.to_z(like.values[self.scaling.index]) - self.z0
            v[self.q : self.q + self.k] = like.state - self.state0
        v[self.q + self.k :] = [x.size / s for x, s in zip(self.entries, self.scales, strict=True)]
        return np.clip(v, self.low, self.high)

    def carried(self, fit: GrowthFit) -> Array:
        """Return the point with tunables and sizes of a fit to another record; the state is this record's own."""
        v = self.with_entries(fit.entries).start(fit)
        v[self.q : self.q + self.k] = 0.0
        return v

    def point(self, v: Array) -> tuple[Array, Array]:
        """Return the full parameter vectors (P, p) of the superset's network and the states (P, k) at v (P, count)."""
        values = np.tile(self.network.values, (len(v), 1))
        values[:, self.scaling.index] = self.scaling.to_values(self.z0 + v[:, : self.q])
        state = self.state0 + v[:, self.q : self.q + self.k]
        return self.model.parameters(values, v[:, self.q + self.k :] * self.scales), state

    def readings(self, v: Array) -> Array:
        """Return the readings (P, n, m) of free runs at v (P, count)."""
        return readings_of([(self, v)])

    def residual(self, v: Array) -> Array:
        """Return the residual (n, m), K, NaN where nothing was measured."""
        off: Array = self.samples.measured - self.readings(v[None, :])[0]
        return off

    def around(self, v: Array) -> Array:
        """Return v and a step from it in each variable (1 + count, count)."""
        return v + np.vstack([np.zeros(v.size), np.diag(self._signed(v))])

    def slopes(self, v: Array, there: Array, around: Array, which: np.ndarray | None = None) -> Array:
        """Return the derivatives (n, m, c) of the readings, from those at v (n, m) and around it (c, n, m).

        Args:
            which: (count,) True for the c variables; all by default.
        """
        steps = self._signed(v) if which is None else self._signed(v)[which]
        return np.moveaxis((around - there) / steps[:, None, None], 0, 2)

    def taken_over(self, near: GrowthFit) -> tuple[Array, np.ndarray]:
        """Return the derivatives (n, m, count) that a fit of some of the effects has, and (count,) True where it has
        none.
        """
        own = near.problem
        first = self.q + self.k
        known = {id(x.candidate): i for i, x in enumerate(own.entries)}
        found = np.zeros((*near.slopes.shape[:2], first + self.e))
        found[:, :, :first] = near.slopes[:, :, :first]
        lacking = np.zeros(first + self.e, dtype=bool)
        for i, x in enumerate(self.entries):
            j = known.get(id(x.candidate))
            if j is None:
                lacking[first + i] = True
            else:
                found[:, :, first + i] = near.slopes[:, :, first + j] * (self.scales[i] / own.scales[j])
        return found, lacking

    def _signed(self, v: Array) -> Array:
        signed: Array = np.where(v + self.steps > self.high, -self.steps, self.steps)
        return signed

    def fitted(self, v: Array, readings: Array) -> GrowthFit:
        """Return the fit at v, the minimum of the squares, with its readings (n, m)."""
        residual = self.samples.measured - readings
        unlikely, spectrum = judged(cosines(residual, self.present), self.samples.sigma)
        cost = unlikely + float(v @ self.precision @ v)
        values = self.network.values.copy()
        values[self.scaling.index] = self.scaling.to_values(self.z0 + v[: self.q])
        first = self.q + self.k
        sizes = (v[first:] * self.scales).tolist()
        entries = tuple(replace(x, size=size) for x, size in zip(self.entries, sizes, strict=True))
        z = v[: self.q]
        held = (z <= self.low[: self.q] + 1e-9) | (z >= self.high[: self.q] - 1e-9)
        bound = tuple(name for name, hit in zip(self.scaling.ids, held, strict=True) if hit)
        state = self.state0 + v[self.q : first]
        return GrowthFit(self, v, entries, values, state, residual, spectrum, cost, bound)

    def whitened(self, values: Array, spectrum: Spectrum) -> Array:
        """Return values (n, m, ...) in time as cosine coefficients (n * m, ...) over their standard deviations."""
        c = cosines(values, self.present)
        roots = spectrum.roots.reshape(c.shape[0], c.shape[1], *([1] * (c.ndim - 2)))
        flat: Array = (c / roots).reshape(-1, *c.shape[2:])
        return flat


def readings_of(asked: Sequence[tuple[GrowthProblem, Array]]) -> Array:
    """Return the readings (all P, n, m) of problems of one superset and with the same inputs, each at v (P, count)."""
    samples, superset = asked[0][0].samples, asked[0][0].superset
    points = [problem.point(v) for problem, v in asked]
    full, state = (np.concatenate(rows) for rows in zip(*points, strict=True))
    if samples.at_rest:
        return superset.resting.readings(samples.inputs, full)
    found = np.empty((len(full), *samples.measured.shape))
    own = [superset.specialised.of(problem.kinds) for problem, v in asked for _ in v]
    for one in dict.fromkeys(own):
        rows = np.array([o is one for o in own])
        part = full[np.ix_(rows, one.columns)], state[rows]
        found[rows] = one.kernel.trace(*part, samples.time, samples.inputs, FEW_LANES)[0]
    return np.stack([centred(one, samples.centre) for one in found]) if samples.means else found
