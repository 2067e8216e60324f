"""Joint fit of effects and tunables, in the network that has the effects as real elements.

Damped Gauss-Newton on the whitened block means, with the commissioned distribution of the tunables as their prior. It
begins at the commissioned values: tunables that have already compensated for an effect lead to other minima.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.probe import FreeRun
from twin.discovery.effects.shapes import TIMED, Shape
from twin.discovery.records.grid import Grid
from twin.discovery.refit.model import Model
from twin.discovery.refit.stepping import LeastSquaresProblem, minimise
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.sweep import LAST_SHARE
from twin.elements.candidates import Candidate
from twin.network import Array
from twin.segments import separate_columns

ROUNDS, AGAIN = 12, 4
"""Rounds of a fit, and of one that continues another of the same effects."""
REACH = 1.0
"""Longest step of a tunable, in standard deviations of a weak prior: derivatives are unreliable beyond, unless they
held so far."""
SHORT = 0.2
"""Largest share of a short transient by which its beginning and end are shifted for derivatives."""
GROWN_S = 180.0
"""Shortest growth time, s; quicker growth is a step. A transient may end within a bin."""
_STEP = 1.0e-4
_STATE_STEP = 1.0e-2
_SIZE_STEP = 1.0e-2


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
    probe, grid, entries = score_test.probe, score_test.grid, model.entries
    scaling, q, k, e = probe.scaling, probe.q, len(grid.begins) * probe.k, len(entries)
    timed = [i for i, x in enumerate(entries) if x.shape.onset_s > 0.0]
    grown = [i for i, x in enumerate(entries) if x.shape.free(grid.span_s)]
    first_time, first_growth = q + k + e, q + k + e + len(timed)
    count = first_growth + len(grown)
    z0 = scaling.to_z(probe.network.values[scaling.index])
    hours, last_h = grid.step_s / 3600.0, grid.span_s / 3600.0
    low, high = np.full(count, -20.0), np.full(count, 20.0)
    low[:q], high[:q] = scaling.to_z(scaling.lower) - z0, scaling.to_z(scaling.upper) - z0
    # A place holds what an effect comes to within the record, not what a ramp that goes on comes to after it.
    most = np.array([x.shape.reached(grid.span_s) if x.shape.name == "ramp" else 1.0 for x in entries])
    low[q + k : first_time] = [x.candidate.lower for x in entries] / most
    high[q + k : first_time] = [x.candidate.upper for x in entries] / most
    # Onsets are in hours, growth times in the logarithm of hours.
    low[first_time:first_growth], high[first_time:first_growth] = 0.0, LAST_SHARE * last_h
    low[first_growth:] = [np.log((grid.step_s if entries[i].shape.name in TIMED else GROWN_S) / 3600.0) for i in grown]
    high[first_growth:] = np.log(10.0 * last_h)
    reach = np.full(count, np.inf)
    reach[:q], reach[q : q + k] = REACH * scaling.prior_sd(), 5.0
    reach[first_time:first_growth], reach[first_growth:] = 1.0, 0.7
    precision = np.zeros((count, count))
    precision[: q + k, : q + k] = score_test.prior.precision
    steps = np.full(count, _STEP)
    steps[q : q + k] = _STATE_STEP
    steps[q + k : first_time] = [_SIZE_STEP * x.candidate.typical for x in entries]
    steps[first_time:first_growth], steps[first_growth:] = 6.0 * hours, 0.05
    for place, i in enumerate(grown):
        # A period is told by where its last turn is; the end of a spell as closely as its beginning.
        shape = entries[i].shape
        if shape.name in ("periodic", "spell"):
            told_s = grid.span_s if shape.name == "periodic" else shape.growth_s
            steps[first_growth + place] = min(6.0 * grid.step_s / max(told_s, grid.step_s), SHORT)
            reach[first_growth + place] = score_test.step_s / max(told_s, grid.step_s)
    for place, i in enumerate(timed):
        if entries[i].shape.name in ("spell", "pulse"):
            # Its beginning and its end bend the readings apart.
            steps[first_time + place] = float(np.clip(SHORT * entries[i].shape.growth_s / 3600.0, hours, 6.0 * hours))
    scale = np.ones(count)
    scale[q + k : first_time] = [x.candidate.typical for x in entries]

    def shapes_at(v: Array) -> tuple[Shape, ...]:
        found = [x.shape for x in entries]
        for place, i in enumerate(timed):
            found[i] = replace(found[i], onset_s=float(max(v[first_time + place], 0.0) * 3600.0))
        for place, i in enumerate(grown):
            found[i] = replace(found[i], growth_s=float(np.exp(v[first_growth + place]) * 3600.0))
        return tuple(found)

    def run(v: Array) -> Array:
        """Return the readings of runs at v (P, count)."""
        values = np.tile(probe.network.values, (len(v), 1))
        values[:, scaling.index] = scaling.to_values(z0 + v[:, :q])
        shapes = tuple(shapes_at(row) for row in v)
        start, sizes = state[:k] + v[:, q : q + k], v[:, q + k : first_time]
        return simulated(model, grid, start, values, sizes, shapes)

    def look(rows: Array) -> Array:
        """Return the whitened residuals (P, rows) of runs at `rows` (P, count)."""
        return score_test.residuals_of(run(rows))

    def slopes_at(v: Array) -> tuple[Array, Array]:
        """Return the whitened derivatives (rows, count), and those (rows, onsets) of onsets towards earlier times."""
        sign = np.where(v + steps > high, -steps, steps)
        alone = np.diag(sign)
        # A beginning is felt in its own segment alone, so that all of them are moved at once.
        at_once = alone[q : q + k].reshape(-1, probe.k, count).sum(axis=0)
        moves = np.vstack([np.zeros(count), alone[:q], at_once, alone[q + k :], -np.diag(steps)[onsets]])
        # A run is cut where any of those beside it is: only with these is the difference that of the move.
        seen = score_test.seen(run(v + moves))
        change = np.moveaxis(seen[1:] - seen[0], 0, 2)
        states = separate_columns(change[..., q : q + probe.k], score_test.begins)
        each = np.concatenate([change[..., :q], states, change[..., q + probe.k :]], axis=2)
        both = score_test.features(each / np.append(sign, -steps[onsets]))
        return both[:, :count], both[:, count:]

    onsets = np.arange(first_time, first_growth)
    v = np.zeros(count)
    v[: q + k] = 0.0 if moved is None else moved
    v[q + k : first_time] = [x.size for x in entries]
    v[onsets] = [entries[i].shape.onset_s / 3600.0 for i in timed]
    v[first_growth:] = [np.log(entries[i].shape.growth_s / 3600.0) for i in grown]
    v = np.clip(v, low, high)
    squares = LeastSquaresProblem(
        look, slopes_at, precision, low, high, reach, onsets, score_test.step_s / 3600.0, scale
    )
    found, slopes, done = minimise(squares, v, rounds)
    v = found.v
    covariance = covariance_of(
        slopes.T @ slopes + precision,
        np.maximum(scale, np.abs(v)),
        (q + k, first_time, first_growth),
        grid.span_s / 3600.0,
    )
    sd = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    shapes = shapes_at(v)
    onset_sd, size_sd = np.zeros(e), sd[q + k : first_time].copy()
    onset_sd[timed] = sd[first_time:first_growth] * 3600.0
    for i in (i for i, x in enumerate(entries) if x.shape.grows):
        # Size, onset and growth of what has not ended growing are not told from one another; what they come to is.
        reached = np.array([shapes_at(row)[i].reached(grid.span_s) for row in (v, *(v + np.diag(steps)))])
        slope = v[q + k + i] * (reached[1:] - reached[0]) / steps
        slope[q + k + i] = reached[0]
        size_sd[i] = math.sqrt(max(float(slope @ covariance @ slope), 0.0)) / max(reached[0], 1e-9)
    fitted = tuple(
        replace(
            x,
            size=float(v[q + k + i]),
            sd=float(size_sd[i]),
            shape=shapes[i],
            onset_sd_s=float(onset_sd[i]),
            on_bound=_on_bound(x.candidate, float(v[q + k + i]), float(most[i])),
        )
        for i, x in enumerate(entries)
    )
    fitted = tuple(_going_on(x, grid.span_s) for x in fitted)
    score_test.take(found.residual, v[: q + k])
    values = probe.network.values.copy()
    values[scaling.index] = scaling.to_values(z0 + v[:q])
    chi = float(found.residual @ found.residual) / max(score_test.count, 1)
    away = float(v[: q + k] @ score_test.prior.precision @ v[: q + k])
    return Fit(fitted, v[: q + k], values, state[:k] + v[q : q + k], found.total, chi, away, found.residual, done)


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
