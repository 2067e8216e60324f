"""Variables of a joint fit: their order in one vector, their bounds, and the steps by which they move.

The vector v (c,) holds, in this order,

    tunables  (q,)      change of z (`gauss_newton.Scaling`) from the commissioned value
    state     (s * k,)  K, change of the temperatures at the beginning of each segment
    sizes     (e,)      in the candidates' units
    onsets    (t,)      h from the record's beginning, of the effects that have one
    growths   (g,)      logarithm of h, growth times of the effects whose record identifies them
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.discovery.effects.shapes import Shape
from twin.discovery.scoring.score_tests import ScoreTest
from twin.discovery.scoring.search import Entry
from twin.discovery.scoring.sweep import LAST_SHARE
from twin.elements.candidates import INTERMITTENT
from twin.network import Array

REACH = 1.0
"""Longest step of a tunable, in standard deviations of a weak prior: derivatives are unreliable beyond, unless they
held so far."""
STATE_REACH_K, ONSET_REACH_H, GROWTH_REACH = 5.0, 1.0, 0.7
"""Longest steps of the state, K, a standard deviation of its prior; of an onset, h; and of the logarithm of a growth
time, a factor of two."""
STATE_BOUND_K = 20.0
"""Largest change of the initial state, K: four standard deviations of its prior, so that it hardly binds."""
GROWN_S = 180.0
"""Shortest growth time, s; quicker growth is a step. A transient may end within a bin."""
LONGEST_GROWTH = 10.0
"""Longest growth time, in lengths of the record: such growth is a straight line in it."""
Z_STEP, STATE_STEP_K, SIZE_STEP = 1.0e-4, 1.0e-2, 1.0e-2
"""Steps of the differences: of z, of the state, K, and of a size, in typical sizes."""
ONSET_STEP, GROWTH_STEP = 6.0, 0.05
"""The same of an onset, in bins, and of the logarithm of a growth time: both are felt beyond the rounding to bins."""
SHORT = 0.2
"""Largest share of a short transient by which its beginning and end are shifted for derivatives."""
MOST_LOST = 0.9
"""Share of all of a flow with whose loss a fit begins at most: volumes are ten times slower then, and still have a
slope."""


@dataclass(frozen=True)
class Variables:
    """Layout of the vector v (c,) of a joint fit.

    Attributes:
        z0: (q,) z of the commissioned tunables. tunables, state, sizes, onsets, growths: their places in v.
        with_onset, with_growth: (t,) and (g,) indices of the effects that have the time.
        reached: (e,) amplitude to which a size of 1 grows by the record's end: bounds of a place hold for that, and not
            for what a ramp that goes on comes to after it.
    """

    entries: tuple[Entry, ...]
    z0: Array
    tunables: slice
    state: slice
    sizes: slice
    onsets: slice
    growths: slice
    with_onset: tuple[int, ...]
    with_growth: tuple[int, ...]
    reached: Array

    @classmethod
    def of(cls, score_test: ScoreTest, entries: tuple[Entry, ...]) -> Variables:
        """Return the variables of a fit of some effects to a score test's record."""
        probe, grid = score_test.probe, score_test.grid
        with_onset = tuple(i for i, x in enumerate(entries) if x.shape.onset_s > 0.0)
        with_growth = tuple(i for i, x in enumerate(entries) if x.shape.free(grid.span_s))
        state = probe.q
        sizes = state + len(grid.begins) * probe.k
        onsets = sizes + len(entries)
        growths = onsets + len(with_onset)
        return cls(
            entries,
            z0=probe.scaling.to_z(probe.network.values[probe.scaling.index]),
            tunables=slice(0, state),
            state=slice(state, sizes),
            sizes=slice(sizes, onsets),
            onsets=slice(onsets, growths),
            growths=slice(growths, growths + len(with_growth)),
            with_onset=with_onset,
            with_growth=with_growth,
            reached=np.array([x.shape.reached(grid.span_s) if x.shape.name == "ramp" else 1.0 for x in entries]),
        )

    @property
    def count(self) -> int:
        """Return the number c of variables."""
        return int(self.growths.stop)

    @property
    def moved(self) -> slice:
        """Return the places of tunables and state."""
        return slice(0, self.state.stop)

    def at_start(self, moved: Array | None) -> Array:
        """Return v (c,) at the entries' sizes and times; `moved` (q + s * k,) are tunables and state, or 0.

        A fit that begins with no flow at all finds no way from there. So its first start has some of a flow left.
        """
        v = np.zeros(self.count)
        v[self.moved] = 0.0 if moved is None else moved
        v[self.sizes] = [_with_some_left(x) if moved is None else x.size for x in self.entries]
        v[self.onsets] = [self.entries[i].shape.onset_s / 3600.0 for i in self.with_onset]
        v[self.growths] = [np.log(self.entries[i].shape.growth_s / 3600.0) for i in self.with_growth]
        return v

    def shapes_at(self, v: Array) -> tuple[Shape, ...]:
        """Return the effects' time courses (e,) at v (c,)."""
        found = [x.shape for x in self.entries]
        for i, hours in zip(self.with_onset, v[self.onsets], strict=True):
            found[i] = replace(found[i], onset_s=float(max(hours, 0.0) * 3600.0))
        for i, log_hours in zip(self.with_growth, v[self.growths], strict=True):
            found[i] = replace(found[i], growth_s=float(np.exp(log_hours) * 3600.0))
        return tuple(found)

    def bounds(self, score_test: ScoreTest) -> tuple[Array, Array]:
        """Return the least and the largest v (c,)."""
        grid, scaling, span_h = score_test.grid, score_test.probe.scaling, score_test.grid.span_s / 3600.0
        low, high = np.full(self.count, -STATE_BOUND_K), np.full(self.count, STATE_BOUND_K)
        low[self.tunables], high[self.tunables] = (
            scaling.to_z(scaling.lower) - self.z0,
            scaling.to_z(scaling.upper) - self.z0,
        )
        low[self.sizes] = [x.candidate.lower for x in self.entries] / self.reached
        high[self.sizes] = [x.candidate.upper for x in self.entries] / self.reached
        low[self.onsets], high[self.onsets] = 0.0, LAST_SHARE * span_h
        shapes = [self.entries[i].shape for i in self.with_growth]
        low[self.growths] = [np.log((grid.step_s if s.name in INTERMITTENT else GROWN_S) / 3600.0) for s in shapes]
        high[self.growths] = np.log(LONGEST_GROWTH * span_h)
        return low, high

    def longest_steps(self, score_test: ScoreTest) -> Array:
        """Return the longest step (c,) of each variable for which derivatives are taken to hold."""
        reach = np.full(self.count, np.inf)
        reach[self.tunables], reach[self.state] = REACH * score_test.probe.scaling.prior_sd(), STATE_REACH_K
        reach[self.onsets], reach[self.growths] = ONSET_REACH_H, GROWTH_REACH
        for place, moved_s in self._moving_edges(score_test):
            reach[place] = score_test.step_s / moved_s
        return reach

    def difference_steps(self, score_test: ScoreTest) -> Array:
        """Return the step (c,) by which each variable is moved for its derivative."""
        step_s = score_test.grid.step_s
        hours = step_s / 3600.0
        steps = np.full(self.count, Z_STEP)
        steps[self.state] = STATE_STEP_K
        steps[self.sizes] = [SIZE_STEP * x.candidate.typical for x in self.entries]
        steps[self.onsets], steps[self.growths] = ONSET_STEP * hours, GROWTH_STEP
        for place, moved_s in self._moving_edges(score_test):
            steps[place] = min(ONSET_STEP * step_s / moved_s, SHORT)
        for place, i in enumerate(self.with_onset, self.onsets.start):
            shape = self.entries[i].shape
            if shape.name in ("transient", "pulse"):
                # Its beginning and its end move the readings apart.
                steps[place] = float(np.clip(SHORT * shape.growth_s / 3600.0, hours, ONSET_STEP * hours))
        return steps

    def large_changes(self) -> Array:
        """Return a large change (c,) of each variable, in its unit: the typical size of a size, and 1 of the others."""
        scale = np.ones(self.count)
        scale[self.sizes] = [x.candidate.typical for x in self.entries]
        return scale

    def _moving_edges(self, score_test: ScoreTest) -> list[tuple[int, float]]:
        """Return the growth times that move an edge of an effect: place in v, and s by which a factor of e moves it.

        The last turn of a periodic effect identifies its period, and the end of a single transient its length.
        """
        grid, found = score_test.grid, []
        for place, i in enumerate(self.with_growth, self.growths.start):
            shape = self.entries[i].shape
            if shape.name in ("periodic", "transient"):
                moved_s = grid.span_s if shape.name == "periodic" else shape.growth_s
                found.append((place, max(moved_s, grid.step_s)))
        return found


def _with_some_left(entry: Entry) -> float:
    """Return the size of an entry, or the largest loss of a flow that still leaves some."""
    most = MOST_LOST * entry.candidate.total_loss
    return most if most and entry.size / most > 1.0 else entry.size
