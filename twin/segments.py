"""Segments of a record, separated by gaps in which the inputs are unknown.

A twin can be run across missing readings, but not across missing inputs: a heater of 1 kW warms a tank by a degree in a
quarter of an hour. So after such a gap the twin restarts, at temperatures from the readings, and readings inside the
gap are ignored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.elements.base import STAMP
from twin.kernel import Kernel
from twin.network import Array, Network

LONG_GAP_S = 300.0
"""Length from which a gap separates segments even where all inputs are afterwards as before, s."""
SHORT_GAP_S = 20.0
"""Length from which a gap separates segments where an input has changed meanwhile, s."""
GAP_PERIODS = 3.0
"""Number of typical steps of a record that are never a gap, however long they are."""
CHANGED_SHARE = 0.02
"""Share of its declared range by which an input must differ to count as changed."""
LOGGED_SHARE = 0.5
"""Share of the samples in which an input must have a value; an input with fewer is recorded only when it changes."""
CLOCK_PREFIX = "time_of_day"
"""Beginning of the name of an input that advances by itself, a clock."""
MOST_GAPS = 24
"""Largest number of restarts from the readings; the longest gaps come first."""


@dataclass(frozen=True)
class Segments:
    """The segments of a record.

    Attributes
    ----------
    begins
        Rows at which the twin restarts: the first one and those after gaps.
    lost
        (N,) bool, rows inside gaps.
    gaps
        First and last time of each gap, s.
    known
        First row at which the inputs are known, and the row after the last one.
    """

    begins: tuple[int, ...]
    lost: np.ndarray
    gaps: tuple[tuple[float, float], ...]
    known: tuple[int, int | None] = (0, None)

    @property
    def sentence(self) -> str:
        """Return a sentence for the operator about the gaps; "" where there is none."""
        if not self.gaps:
            return ""
        total = sum(b - a for a, b in self.gaps) / 60.0
        longest = max(self.gaps, key=lambda g: g[1] - g[0])
        where = f"{longest[0] / 3600.0:.1f} h"
        if len(self.gaps) == 1:
            return (
                f"the inputs are unknown for {total:.3g} min at {where}: the twin restarts after that, at temperatures "
                "from the readings"
            )
        return (
            f"the inputs are unknown in {len(self.gaps)} gaps of {total:.3g} min together (the longest at {where}): "
            "the twin restarts after each, at temperatures from the readings"
        )


def find_segments(network: Network, time: Array, inputs: Array) -> Segments:
    """Find the segments of a record.

    Temperatures of the surroundings are slow: in a gap they lie on a straight line and separate nothing.

    Parameters
    ----------
    network
        The network whose inputs count.
    time
        (N,) s, not decreasing.
    inputs
        (N, c) with NaN where there was no value.
    """
    driven = [
        j
        for j, c in enumerate(network.input_columns)
        if not c.endswith("_C") and not c.startswith(CLOCK_PREFIX) and c != STAMP
    ]
    good = np.isfinite(inputs[:, driven])
    good |= good.mean(axis=0) < LOGGED_SHARE if len(inputs) else False
    rows = np.flatnonzero(good.all(axis=1))
    lost = np.zeros(len(time), dtype=bool)
    if len(rows) < 2:
        return Segments((0,), lost, ())
    length = np.diff(time[rows])
    span = np.array([spec.upper - spec.lower for spec in network.inputs.values()])[driven]
    # A missing value here is that of an input which is recorded only when it changes.
    values = np.nan_to_num(inputs[:, driven])
    away = np.abs(np.diff(values[rows], axis=0)) * np.isfinite(inputs[rows[1:]][:, driven])
    moved = (away > CHANGED_SHARE * np.where(np.isfinite(span), span, np.ptp(values[rows], axis=0))).any(axis=1)
    gap = (length > LONG_GAP_S) | ((length > SHORT_GAP_S) & moved)
    gap &= length > GAP_PERIODS * float(np.median(np.diff(time)))
    found = np.flatnonzero(gap)
    found = np.sort(found[np.argsort(-length[found], kind="stable")[:MOST_GAPS]])
    for i in found:
        lost[rows[i] + 1 : rows[i + 1]] = True
    gaps = tuple((float(time[rows[i]]), float(time[rows[i + 1]])) for i in found)
    begins = (0, *(int(rows[i + 1]) for i in found))
    return Segments(begins, lost, gaps, (int(rows[0]), int(rows[-1]) + 1))


def segment_rows(begins: tuple[int, ...], rows: int) -> tuple[slice, ...]:
    """Return the rows of each segment of a record of `rows`."""
    return tuple(slice(a, b) for a, b in zip(begins, (*begins[1:], rows), strict=True))


def simulate_segments(
    kernel: Kernel, parameters: Array, states: Array, time: Array, inputs: Array, begins: tuple[int, ...]
) -> Array:
    """Simulate runs that restart in each segment, at its own temperatures; return readings (P, n, m) in degC.

    Parameters
    ----------
    kernel
        The compiled network.
    parameters
        (P, p).
    states
        (P, s * k) node temperatures in degC, segment by segment.
    time, inputs, begins
        (n,) s, (n, c), and the first rows of the segments.
    """
    begun = states.reshape(len(states), len(begins), -1)
    found, state = [], np.ascontiguousarray(begun[:, 0])
    for i, rows in enumerate(segment_rows(begins, len(time))):
        state = restarted_states(state, begun[:, i]) if i else state
        until = min(rows.stop + 1, len(time))
        readings, state = kernel.trace(parameters, state, time[rows.start : until], inputs[rows.start : until])
        found.append(readings[:, : rows.stop - rows.start])
    return found[0] if len(found) == 1 else np.concatenate(found, axis=1)


def restarted_states(state: Array, temperatures: Array) -> Array:
    """Return full states (P, size) with other node temperatures (P, k); all other memory stays."""
    out = np.tile(state, (len(temperatures) // len(state), 1))
    out[:, : temperatures.shape[1]] = temperatures
    return out


def separate_columns(slopes: Array, begins: tuple[int, ...]) -> Array:
    """Return slopes (n, ..., k) of the temperatures at all restarts together as (n, ..., s * k), one block per
    segment.
    """
    k = slopes.shape[-1]
    out = np.zeros((*slopes.shape[:-1], len(begins) * k))
    for i, rows in enumerate(segment_rows(begins, len(slopes))):
        out[rows, ..., i * k : (i + 1) * k] = slopes[rows]
    return out
