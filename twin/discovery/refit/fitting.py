"""Joint fit of effects and tunables, in the network that has the effects as real elements.

Damped Gauss-Newton on the whitened block means, with the commissioned distribution of the tunables as their prior. It
begins at the commissioned values: tunables that have already compensated for an effect lead to other minima.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.probe import FreeRun
from twin.discovery.effects.shapes import Shape
from twin.discovery.records.grid import Grid
from twin.discovery.refit.model import Model
from twin.discovery.refit.stepping import LeastSquaresProblem, minimise
from twin.discovery.refit.variables import Variables
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.elements.candidates import Candidate
from twin.network import Array
from twin.segments import separate_columns

ROUNDS, AGAIN = 12, 4
"""Rounds of a fit, and of one that continues another of the same effects."""


@dataclass(frozen=True)
class Fit:
    """Joint fit of effects and tunables.

    Attributes:
        entries: with their sizes and standard deviations. moved: (q + s * k,) of [tunables z, initial state] from
            commissioning. values: (p,) of the original network. state: (s * k,), degC, at the first bin of each
            segment.
        total: weighted squares, of residual and of tunables against their prior. chi: residual's per block and sensor.
        away: those of the tunables, which are large if the fit compensates for a missing effect.
        residual: (b * m,) whitened, of the score test that it was fitted in.
        done: whether it has converged.
    """

    entries: tuple[Entry, ...]
    moved: Array
    values: Array
    state: Array
    total: float
    chi: float
    away: float
    residual: Array
    done: bool


def fit(score_test: ScoreTest, model: Model, state: Array, moved: Array | None = None, rounds: int = ROUNDS) -> Fit:
    """Minimise the score test's squares over tunables, initial state and sizes; the score test then holds the result.

    Args:
        state: temperatures (s * k,), degC, at the beginnings of segments, about which the score test was linearised.
        moved: (q + s * k,) of [tunables z, initial state] at the end of another fit of the same effects, as start
            point.
        rounds: steps at most.
    """
    variables = Variables.of(score_test, model.entries)
    residual = _JointResidual(score_test, model, state, variables)
    precision = np.zeros((variables.count, variables.count))
    precision[variables.moved, variables.moved] = score_test.prior.precision
    low, high = residual.bounds
    problem = LeastSquaresProblem(
        residual.residuals,
        residual.jacobian,
        precision,
        low,
        high,
        variables.longest_steps(score_test),
        np.arange(variables.onsets.start, variables.onsets.stop),
        score_test.step_s / 3600.0,
        variables.large_changes(),
    )
    found, jacobian, done = minimise(problem, np.clip(variables.at_start(moved), low, high), rounds)
    at, v = found.v[variables.moved], found.v
    covariance = covariance_of(
        jacobian.T @ jacobian + precision,
        np.maximum(problem.scale, np.abs(v)),
        (variables.sizes.start, variables.onsets.start, variables.growths.start),
        score_test.grid.span_s / 3600.0,
    )
    score_test.take(found.residual, at)
    return Fit(
        entries=_estimated(variables, v, covariance, residual.steps, score_test.grid.span_s),
        moved=at,
        values=residual.values_at(v[None])[0],
        state=residual.state + v[variables.state],
        total=found.total,
        chi=float(found.residual @ found.residual) / max(score_test.count, 1),
        away=float(at @ score_test.prior.precision @ at),
        residual=found.residual,
        done=done,
    )


class _JointResidual:
    """Whitened residual of a score test's record as a function of the variables of a fit, and its Jacobian.

    Args:
        state: temperatures (s * k,), degC, from which the variables count.

    Attributes:
        bounds: (c,) and (c,). steps: (c,) of the differences.
    """

    def __init__(self, score_test: ScoreTest, model: Model, state: Array, variables: Variables) -> None:
        self.score_test, self.model, self.variables = score_test, model, variables
        self.state = state[: variables.state.stop - variables.state.start]
        self.bounds, self.steps = variables.bounds(score_test), variables.difference_steps(score_test)

    def values_at(self, v: Array) -> Array:
        """Return the parameters (P, p) of the original network at v (P, c)."""
        probe, place = self.score_test.probe, self.variables.tunables
        values = np.tile(probe.network.values, (len(v), 1))
        values[:, probe.scaling.index] = probe.scaling.to_values(self.variables.z0 + v[:, place])
        return values

    def readings(self, v: Array) -> Array:
        """Return the readings (P, n, m), degC, of runs at v (P, c)."""
        state, sizes = self.state + v[:, self.variables.state], v[:, self.variables.sizes]
        shapes = tuple(self.variables.shapes_at(row) for row in v)
        return simulated(self.model, self.score_test.grid, state, self.values_at(v), sizes, shapes)

    def residuals(self, v: Array) -> Array:
        """Return the whitened residuals (P, rows) of runs at v (P, c)."""
        return self.score_test.residuals_of(self.readings(v))

    def jacobian(self, v: Array) -> tuple[Array, Array]:
        """Return the whitened derivatives (rows, c) at v (c,), and those (rows, t) of onsets towards earlier times."""
        variables, score_test, steps = self.variables, self.score_test, self.steps
        k, onsets = score_test.probe.k, variables.onsets
        sign = np.where(v + steps > self.bounds[1], -steps, steps)
        alone = np.diag(sign)
        # A beginning is felt in its own segment alone, so that all of them are moved at once.
        at_once = alone[variables.state].reshape(-1, k, variables.count).sum(axis=0)
        first, last = variables.tunables, slice(variables.sizes.start, None)
        moves = np.vstack([np.zeros(variables.count), alone[first], at_once, alone[last], -np.diag(steps)[onsets]])
        # A run is cut where any of those beside it is: only with these is the difference that of the move.
        seen = score_test.seen(self.readings(v + moves))
        change = np.moveaxis(seen[1:] - seen[0], 0, 2)
        q = first.stop
        states = separate_columns(change[..., q : q + k], score_test.begins)
        each = np.concatenate([change[..., :q], states, change[..., q + k :]], axis=2)
        both = score_test.features(each / np.append(sign, -steps[onsets]))
        return both[:, : variables.count], both[:, variables.count :]


def _estimated(variables: Variables, v: Array, covariance: Array, steps: Array, span_s: float) -> tuple[Entry, ...]:
    """Return the effects with their sizes, times and standard deviations at v (c,) with this covariance (c, c)."""
    entries, shapes = variables.entries, variables.shapes_at(v)
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    onset_sd, size_sd = np.zeros(len(entries)), sd[variables.sizes].copy()
    onset_sd[list(variables.with_onset)] = sd[variables.onsets] * 3600.0
    for i in (i for i, x in enumerate(entries) if x.shape.grows):
        # Size, onset and growth of an effect that still grows are correlated; what it comes to is identifiable.
        reached = np.array([variables.shapes_at(row)[i].reached(span_s) for row in (v, *(v + np.diag(steps)))])
        place = variables.sizes.start + i
        slope = v[place] * (reached[1:] - reached[0]) / steps
        slope[place] = reached[0]
        size_sd[i] = math.sqrt(max(float(slope @ covariance @ slope), 0.0)) / max(reached[0], 1e-9)
    sizes = v[variables.sizes]
    fitted = (
        replace(
            x,
            size=float(sizes[i]),
            sd=float(size_sd[i]),
            shape=shapes[i],
            onset_sd_s=float(onset_sd[i]),
            on_bound=_on_bound(x.candidate, float(sizes[i]), float(variables.reached[i])),
        )
        for i, x in enumerate(entries)
    )
    return tuple(_going_on(x, span_s) for x in fitted)


def covariance_of(normal: Array, order: Array, firsts: tuple[int, int, int], span_h: float) -> Array:
    """Return the covariance (count, count) of a fit from its normal matrix.

    `order` (count,) has the typical sizes, or the sizes where they are larger; `firsts` are the places of the first
    size, onset and growth. Of what lasts for seconds the record tells the energy alone, and not how strong and how long
    it was: a direction of which it says nothing is as wide as a size of its own order, an onset anywhere and a factor
    of e in length.
    """
    size, time, growth = firsts
    weak = np.zeros(len(normal))
    weak[size:time] = order[size:time] ** -2.0
    weak[time:growth], weak[growth:] = span_h**-2.0, 1.0
    whole = normal + np.diag(weak)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
    # Of units alike, no direction is so flat that rounding decides.
    scaled = np.linalg.pinv(whole * np.outer(scale, scale), rcond=1e-15, hermitian=True)
    return np.asarray(scaled * np.outer(scale, scale))


def simulated(
    model: Model, grid: Grid, state: Array, values: Array, sizes: Array, shapes: tuple[tuple[Shape, ...], ...] | None
) -> Array:
    """Return readings (P, n, m), degC, at the mean times of the samples of bins; arguments as those of `Model.run`."""
    readings = model.run(grid.time, grid.inputs, state, values, sizes, shapes, grid.begins)
    readings[:, :-1] += grid.centre * np.diff(readings, axis=1)
    return readings


def look_at(score_test: ScoreTest, model: Model, found: Fit) -> None:
    """Set the score test's residual to that of a fit; the model is of its effects."""
    sizes = np.array([[e.size for e in model.entries]])
    grid = score_test.grid
    (readings,) = simulated(model, grid, found.state[None], found.values[None], sizes, None)
    score_test.look_at(FreeRun(readings, readings), found.moved)


def _on_bound(candidate: Candidate, size: float, most: float) -> bool:
    """Return True for a size on a bound of what its place can have, where a ramp comes to `most` of its size."""
    if size <= candidate.lower / most:
        return candidate.at_bound(candidate.lower)
    return size >= candidate.upper / most and candidate.at_bound(candidate.upper)


def _going_on(entry: Entry, span_s: float) -> Entry:
    """Return an entry that still rises or is present at the record's end without an end of its course."""
    grown = entry.going_on(span_s, span_s)
    return replace(grown, shape=grown.shape.going_on(span_s))
