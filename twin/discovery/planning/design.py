"""Design of experiments for isolation: load, pump and fan levels, half an hour by half an hour.

Every hypothesis is simulated from the record's end, with its own tunables and sizes, over a further half hour at
each combination of levels. The combination is chosen that maximises the least expected difference between any two
(T-optimality for two models, Atkinson & Fedorov, Biometrika 62 (1975) 57; taken step by step). The part that the
wrong hypothesis could explain by its tunables, initial state and sizes is projected out.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.probe import Probe
from twin.discovery.effects.shapes import Shape
from twin.discovery.records.grid import Grid, centred
from twin.discovery.records.noise import Noise
from twin.discovery.refit.fitting import Fit
from twin.discovery.refit.model import Model
from twin.discovery.scoring.search import Entry
from twin.gauss_newton import GaussianPrior
from twin.network import Array

SEGMENT_S = 1800.0
"""Time for which the levels of an experiment are held, s."""
LEAST_SEGMENTS, MOST_SEGMENTS = 4, 16
"""Length of an experiment in such segments: two to eight hours."""
NEARLY = 0.03
"""Share of a sufficient difference below which further gain counts in proportion, and above which it saturates."""
BLOCK_S = 300.0
"""Length of a block of an experiment, s: about that of a record of a day."""
_STEP, _STATE_STEP, _SIZE_STEP = 1.0e-4, 1.0e-2, 1.0e-2
"""Steps of the differences: of z, of the state, K, and of a size, in typical sizes."""
_FREE = 1.0e-12
"""Prior precision of a size, a flat prior: only the change of a reading over time is informative."""


@dataclass(frozen=True)
class Levels:
    """Levels of each driven input column for a plan, and the highest permitted reading, degC."""

    driven: Mapping[str, tuple[float, ...]]
    hottest_C: float

    def combinations(self) -> list[dict[str, float]]:
        """Return every combination of levels."""
        return [dict(zip(self.driven, each, strict=True)) for each in itertools.product(*self.driven.values())]


@dataclass(frozen=True)
class Surroundings:
    """Inputs that are not driven: `base` (c,) at the end of the record; the column of the time of day continues."""

    columns: tuple[str, ...]
    base: Array
    step_s: float

    def inputs(self, begin_s: float, bins: int, levels: Mapping[str, float]) -> tuple[Array, Array]:
        """Return time (n,) s from the plan's beginning and inputs (n, c)."""
        time: Array = begin_s + self.step_s * np.arange(bins, dtype=np.float64)
        out: Array = np.tile(self.base, (bins, 1))
        for j, column in enumerate(self.columns):
            if column in levels:
                out[:, j] = levels[column]
            elif column.startswith("time_of_day"):
                out[:, j] = (self.base[j] + time / 3600.0) % 24.0
        return time, out


class Runner:
    """Simulation of one hypothesis and of its derivatives in all fitted variables.

    Args:
        fitted: the fit of the hypothesis; its effects are present throughout, at their final sizes.
        state: initial temperatures (k,).
    """

    def __init__(self, probe: Probe, fitted: Fit, sizes: Array, prior: GaussianPrior, state: Array) -> None:
        entries = tuple(from_the_start(e, s) for e, s in zip(fitted.entries, sizes.tolist(), strict=True))
        self.entries, self._model = entries, Model.of(probe, entries)
        scaling, q, k, e = probe.scaling, probe.q, probe.k, len(entries)
        count = 1 + q + k + e
        values, all_sizes = np.tile(fitted.values, (count, 1)), np.tile(sizes, (count, 1))
        z = scaling.to_z(fitted.values[scaling.index])
        steps = np.where(z + _STEP > scaling.to_z(scaling.upper), -_STEP, _STEP)
        for i in range(q):
            moved = z.copy()
            moved[i] += steps[i]
            values[1 + i, scaling.index] = scaling.to_values(moved)
        states = np.tile(state[:k], (count, 1))
        states[1 + q : 1 + q + k] += _STATE_STEP * np.eye(k)
        size_steps = np.array([_size_step(x) for x in entries])
        all_sizes[1 + q + k :] += np.diag(size_steps)
        self._scale = np.concatenate([steps, np.full(k, _STATE_STEP), size_steps])
        self._rows, self._all_sizes = self._model.parameters(values, all_sizes), all_sizes
        self.state = states
        precision = np.zeros((count - 1, count - 1))
        precision[: q + k, : q + k] = prior.precision
        precision[q + k :, q + k :] = _FREE * np.eye(e)
        self.precision = precision
        self.sizes, self.effects = sizes, slice(q + k, q + k + e)
        self._own = slice(q, q + k)

    def learn(self, slopes: Array) -> None:
        """Add a record's information about tunables and sizes; its initial state is not that of the next one.

        Args:
            slopes: (rows, q + k + e) of the whitened record, scaled by its reliability.
        """
        inner = slopes.T @ slopes
        own, rest = inner[self._own, self._own], inner[:, self._own]
        inner -= rest @ np.linalg.pinv(own, rcond=1e-12, hermitian=True) @ rest.T
        inner[self._own, :] = inner[:, self._own] = 0.0
        self.precision = self.precision + inner

    def advance(self, state: Array, time: Array, inputs: Array) -> tuple[Array, Array, Array]:
        """Return the readings (n, m) of the hypothesis, derivatives (n, m, q + k + e), and the final states."""
        readings, after = self._model.kernel.trace(self._rows, state, time, self._model.driven(time, inputs))
        all_along = np.ones((*self._all_sizes.shape, 1))
        self._model.read(readings, time, inputs, self._all_sizes, all_along, np.array([0, len(time)]))
        means = np.stack([centred(one) for one in readings])
        slopes = np.moveaxis(means[1:] - means[0], 0, 2) / self._scale
        return means[0], slopes, after


def from_the_start(entry: Entry, size: float) -> Entry:
    """Return the entry as an effect that is present throughout."""
    return replace(entry, shape=Shape("step"), size=size)


def _size_step(entry: Entry) -> float:
    c = entry.candidate
    step = _SIZE_STEP * c.typical
    return -step if entry.size + step > c.upper else step


@dataclass
class _Track:
    """Plan so far: block means of every hypothesis (b, m) and their derivatives (b, m, q + k + e)."""

    states: list[Array]
    means: list[Array]
    slopes: list[Array]


@dataclass(frozen=True)
class Designed:
    """Designed plan: `levels`, one dict per half hour, with its expected information.

    `differences` (h, h): expected fall of the weighted squares of hypothesis i (row) over j (column) if i is true;
    `gains` (h,) that of each over a twin without it; `hottest_C` of all readings.
    """

    levels: tuple[dict[str, float], ...]
    differences: Array
    gains: Array
    hottest_C: float


class Designer:
    """Designer of experiments that isolate hypotheses.

    Args:
        apart: (h, h) excess of hypothesis j's (column) weighted squares over i's (row) on the records so far.
    """

    def __init__(
        self, runners: list[Runner], around: Surroundings, levels: Levels, noise: Noise, apart: Array | None = None
    ) -> None:
        self._runners, self._around, self._levels, self._noise = runners, around, levels, noise
        self._apart = np.zeros((len(runners),) * 2) if apart is None else apart
        self._bins = max(round(SEGMENT_S / around.step_s), 2)
        self.segment_s = self._bins * around.step_s
        self._per_block = max(round(BLOCK_S / around.step_s), 1)
        self._block_s = self._per_block * around.step_s

    def shuffled(self, seed: int = 0, segments: int = MOST_SEGMENTS) -> Designed:
        """Return a plan of random levels: the distinguishability of hypotheses if all drives are varied."""
        rng = np.random.default_rng(seed)
        track, chosen, hottest = self._start(), [], -np.inf
        for number in range(segments):
            options = self._levels.combinations()
            for at in rng.permutation(len(options)):
                step, warmest = self._step(track, number, options[at])
                if warmest <= self._levels.hottest_C:
                    break
            else:
                step, warmest, at = self._coolest(track, number, options)
            track, hottest = _joined(track, step), max(hottest, warmest)
            chosen.append(options[at])
        differences, gains = self.expected(track)
        return Designed(tuple(chosen), differences, gains, hottest)

    def greedy(self, pairs: list[tuple[int, int]], enough: float, share: float) -> Designed:
        """Choose half hours one by one until every pair is expected to differ enough, or the plan has its maximum
        length.

        Args:
            pairs: hypotheses to isolate from each other. enough: difference that settles a pair; `share` of the gain
                that the plan's own record will add is required on top.
        """
        track, chosen, hottest = self._start(), [], -np.inf
        options = self._levels.combinations()
        differences, gains = np.zeros((2, 2)), np.zeros(2)
        for number in range(MOST_SEGMENTS):
            best: tuple[float, _Track, int, float, Array, Array] | None = None
            for at, option in enumerate(options):
                step, warmest = self._step(track, number, option)
                if warmest > self._levels.hottest_C:
                    continue
                longer = _joined(track, step)
                differences, gains = self._in_all(longer)
                # A sum of logarithms drives the least difference up, and also where one half hour alone cannot.
                each = np.array([min(differences[i, j], differences[j, i]) for i, j in pairs])
                score = float(np.log1p(each / (NEARLY * (enough + share * float(gains.max())))).sum())
                if best is None or score > best[0]:
                    best = (score, longer, at, warmest, differences, gains)
            if best is None:
                step, warmest, at = self._coolest(track, number, options)
                longer = _joined(track, step)
                best = (0.0, longer, at, warmest, *self._in_all(longer))
            _, track, at, warmest, differences, gains = best
            chosen.append(options[at])
            hottest = max(hottest, warmest)
            least = min(min(differences[i, j], differences[j, i]) for i, j in pairs)
            if number + 1 >= LEAST_SEGMENTS and least > enough + share * float(gains.max()):
                break
        return Designed(tuple(chosen), differences, gains, hottest)

    def _start(self) -> _Track:
        return _Track([r.state for r in self._runners], [], [])

    def _step(self, track: _Track, number: int, levels: Mapping[str, float]) -> tuple[_Track, float]:
        """Return the plan extended by half an hour, and its highest reading, degC."""
        time, inputs = self._around.inputs(number * self.segment_s, self._bins + 1, levels)
        states, means, slopes, warmest = [], [], [], -np.inf
        for runner, state in zip(self._runners, track.states, strict=True):
            read, slope, after = runner.advance(state, time, inputs)
            states.append(after)
            warmest = max(warmest, float(read.max()))
            means.append(self._blocks(read[: self._bins]))
            slopes.append(self._blocks(slope[: self._bins]))
        return _Track(states, means, slopes), warmest

    def _coolest(self, track: _Track, number: int, options: list[dict[str, float]]) -> tuple[_Track, float, int]:
        tried = [(self._step(track, number, option), at) for at, option in enumerate(options)]
        (step, warmest), at = min(tried, key=lambda x: x[0][1])
        return step, warmest, at

    def _blocks(self, values: Array) -> Array:
        return _block_means(values, self._per_block)

    def expected(self, track: _Track) -> tuple[Array, Array]:
        """Return expected differences (h, h) and gains (h,) of the plan so far."""
        count = len(self._runners)
        white = [self._white(slopes) for slopes in track.slopes]
        inner = [np.linalg.inv(j.T @ j + r.precision) for j, r in zip(white, self._runners, strict=True)]
        out = np.zeros((count, count))
        for i, j in itertools.permutations(range(count), 2):
            d = self._white((track.means[i] - track.means[j])[:, :, None])[:, 0]
            pull = white[j].T @ d
            out[i, j] = max(float(d @ d - pull @ inner[j] @ pull), 0.0)
        gains = np.zeros(count)
        for i, runner in enumerate(self._runners):
            known = np.delete(np.arange(white[i].shape[1]), np.r_[runner.effects])
            effect = white[i][:, runner.effects] @ runner.sizes
            rest = white[i][:, known]
            pull = rest.T @ effect
            normal = rest.T @ rest + runner.precision[np.ix_(known, known)]
            gains[i] = max(float(effect @ effect - pull @ np.linalg.solve(normal, pull)), 0.0)
        return out, gains

    def _in_all(self, track: _Track) -> tuple[Array, Array]:
        """Return expected differences including those of the records so far, and gains."""
        differences, gains = self.expected(track)
        return np.maximum(differences + self._apart, 0.0), gains

    def _white(self, values: Array) -> Array:
        whitened = self._noise.whiten(values, self._block_s)
        return whitened.reshape(-1, values.shape[2])


def informed(runner: Runner, grid: Grid, noise: Noise) -> Array:
    """Return the whitened derivatives (rows, q + k + e) of a record with these inputs, begun in the runner's state."""
    per_block = max(round(BLOCK_S / grid.step_s), 1)
    _, slopes, _ = runner.advance(runner.state, grid.time - grid.time[0], grid.inputs)
    return noise.whiten(_block_means(slopes, per_block), per_block * grid.step_s).reshape(-1, slopes.shape[2])


def _block_means(values: Array, per_block: int) -> Array:
    count = len(values) // per_block
    means: Array = values[: count * per_block].reshape(count, per_block, *values.shape[1:]).mean(axis=1)
    return means


def _joined(track: _Track, step: _Track) -> _Track:
    if not track.means:
        return step
    return _Track(
        step.states,
        [np.concatenate([a, b]) for a, b in zip(track.means, step.means, strict=True)],
        [np.concatenate([a, b]) for a, b in zip(track.slopes, step.slopes, strict=True)],
    )
