"""Healthy record of a commissioning: checked arrays, and the segment of it that no fit uses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.gauss_newton import FitData
from twin.kernel import clean_time, hold_inputs, mask_measurements
from twin.network import Array, Network, TwinFileError
from twin.segments import Segments, find_segments

FEWEST_SAMPLES = 100
"""Samples of a record that can be split: 20 at least are held out of it."""
FIRST_SAMPLES = 30
"""Readings whose mean is the first guess of the initial state, unless an input moves before."""
MOVED = 0.01
"""Share of its declared range by which an input must change to count as moved."""
BEYOND = 0.1
"""Share of an input's declared range by which a segment may leave the range of the rest."""


@dataclass(frozen=True)
class HealthyRecord:
    """Record as a fit takes it, with its held-out segment.

    Attributes
    ----------
    network
        The twin that it is for.
    time, inputs, measured, weight
        (n,) s; (n, c), held where they were missing; (n, m) degC; (n, m) 1/K, 0 where a reading is missing or inputs
        are unknown.
    segments
        Rows at which the twin restarts, and gaps.
    split, end
        First row of the held-out segment, and the row after its last.
    """

    network: Network
    time: Array
    inputs: Array
    measured: Array
    weight: Array
    segments: Segments
    split: int
    end: int

    @classmethod
    def of(
        cls, network: Network, time_s: ArrayLike, inputs: ArrayLike, measured: ArrayLike, held_out: float
    ) -> HealthyRecord:
        """Return the record with a share `held_out` of its time held out.

        Raises
        ------
        TwinFileError
            Time goes back, lengths differ, or there are too few samples or no finite measurement in either part.
        """
        t, u = clean_time(time_s), hold_inputs(network, inputs)
        y, weight = mask_measurements(measured, network.sigma)
        if not len(t) == len(u) == len(y):
            raise TwinFileError(f"time, inputs and measured differ in length: {len(t)}, {len(u)}, {len(y)}")
        window_s = network.rules.window_s
        if len(t) < FEWEST_SAMPLES or t[-1] - t[0] < window_s:
            raise TwinFileError(
                f"the record has {len(t)} samples over {t[-1] - t[0] if len(t) else 0:.0f} s; commissioning needs at "
                f"least {FEWEST_SAMPLES} samples over {window_s:.0f} s"
            )
        segments = find_segments(network, t, np.asarray(inputs, dtype=np.float64).reshape(u.shape))
        weight = np.where(segments.lost[:, None], 0.0, weight)
        record = cls(network, t, u, y, weight, segments, *_held_out_rows(network, t, u, held_out))
        seen = record.fitted
        if not (weight[seen] > 0.0).any() or not (weight[~seen] > 0.0).any():
            raise TwinFileError("the record has no finite measurement in its fitted or in its held-out part")
        return record

    @property
    def fitted(self) -> np.ndarray:
        """Return True (n,) for the rows outside the held-out segment."""
        seen = np.ones(len(self.time), dtype=bool)
        seen[self.split : self.end] = False
        return seen

    @property
    def held_out_s(self) -> tuple[float, float]:
        """Return the first and the last time of the held-out segment, s."""
        return float(self.time[self.split]), float(self.time[self.end - 1])

    @property
    def silent(self) -> list[str]:
        """Return the sensors without any reading."""
        return [name for j, name in enumerate(self.network.sensor_names) if not (self.weight[:, j] > 0.0).any()]

    def data(self) -> FitData:
        """Return the record for a fit: the held-out segment has no weight, or is cut off if it is the end."""
        rows = self.split if self.end == len(self.time) else len(self.time)
        weight = np.where(self.fitted[:, None], self.weight, 0.0)
        begins = tuple(b for b in self.segments.begins if b < rows)
        return FitData(self.time[:rows], self.inputs[:rows], self.measured[:rows], weight[:rows], begins)

    def first_states(self) -> Array:
        """Return a first guess (s * k,), degC, of the state at the beginning of each segment, from its readings."""
        raw = np.where(self.weight > 0.0, self.measured, np.nan)
        begins = self.segments.begins
        firsts = [slice(b, b + _before_any_input_moves(self.network, self.inputs[b:])) for b in begins]
        return np.concatenate([self.network.initial_state(raw[first]) for first in firsts])

    def residual_of(self, readings: Array) -> Array:
        """Return simulated less measured (n, m), K; NaN where a reading is missing."""
        return np.where(self.weight > 0.0, readings - self.measured, np.nan)


def _held_out_rows(network: Network, time: Array, inputs: Array, share: float) -> tuple[int, int]:
    """Return the first row of the held-out segment and the row after it; the record's end where none is better."""
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
