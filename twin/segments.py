"""Where a record has to be followed anew: after a time in which nobody knows what drove the rig.

A twin can be run across missing readings, but not across missing inputs: what a heater of 1 kW did in a quarter of an
hour without a sample is a degree in a tank. So after such a gap the twin begins again, at temperatures that the
readings tell, and what was read in the gap itself is left aside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.kernel import Kernel
from twin.network import Array, Network

LONG_GAP_S = 300.0
"""A gap that is lost even where all inputs are afterwards what they were before."""
SHORT_GAP_S = 20.0
"""The shortest gap that is lost where an input has changed meanwhile."""
GAP_PERIODS = 3.0
"""Typical steps of a record that are no gap, however long they are."""
CHANGED_SHARE = 0.02
"""An input has changed by more than this share of its declared range."""
LOGGED_SHARE = 0.5
"""Share of the samples in which an input has to have a value; one with fewer is written down when it changes."""
CLOCK_PREFIX = "time_of_day"
"""Beginning of the name of an input that goes on by itself."""
MOST_GAPS = 24
"""Beginnings that are told from the readings, those after the longest gaps."""


@dataclass(frozen=True)
class Segments:
    """`begins`: rows at which the rig is followed anew, the first one and those after gaps; `lost`: (N,) bool, rows
    inside gaps; `gaps`: (first, last) time, s, of each gap."""

    begins: tuple[int, ...]
    lost: np.ndarray
    gaps: tuple[tuple[float, float], ...]

    @property
    def sentence(self) -> str:
        """What becomes of the gaps, for an operator; "" where there is none."""
        if not self.gaps:
            return ""
        total = sum(b - a for a, b in self.gaps) / 60.0
        longest = max(self.gaps, key=lambda g: g[1] - g[0])
        where = f"{longest[0] / 3600.0:.1f} h"
        if len(self.gaps) == 1:
            return (
                f"nothing tells what drove the rig for {total:.3g} min at {where}: the twin begins anew after that, at "
                "temperatures that the readings tell"
            )
        return (
            f"nothing tells what drove the rig in {len(self.gaps)} gaps of {total:.3g} min together (the longest at "
            f"{where}): the twin begins anew after each, at temperatures that the readings tell"
        )


def find_segments(network: Network, time: Array, inputs: Array) -> Segments:
    """Stretches of a record with time (N,) s, not decreasing, and inputs (N, c) with NaN where there was no value.

    Temperatures of the surroundings are slow: in a gap they lie on a straight line, and lose nothing.
    """
    driven = [j for j, c in enumerate(network.input_columns) if not c.endswith("_C") and not c.startswith(CLOCK_PREFIX)]
    good = np.isfinite(inputs[:, driven])
    good |= good.mean(axis=0) < LOGGED_SHARE if len(inputs) else False
    rows = np.flatnonzero(good.all(axis=1))
    lost = np.zeros(len(time), dtype=bool)
    if len(rows) < 2:
        return Segments((0,), lost, ())
    length = np.diff(time[rows])
    span = np.array([spec.upper - spec.lower for spec in network.inputs.values()])[driven]
    # What is no value here is one that is written down when it changes.
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
    return Segments(begins, lost, gaps)


def segment_rows(begins: tuple[int, ...], rows: int) -> tuple[slice, ...]:
    """Rows of each stretch of a record of `rows`."""
    return tuple(slice(a, b) for a, b in zip(begins, (*begins[1:], rows), strict=True))


def simulate_segments(
    kernel: Kernel, parameters: Array, states: Array, time: Array, inputs: Array, begins: tuple[int, ...]
) -> Array:
    """Readings (P, n, m) of runs that begin anew in each stretch, at its own temperatures.

    Args:
        parameters: (P, p). states: (P, s * k). time: (n,) s. inputs: (n, c).
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
    """Full states (P, size) with other node temperatures (P, k): masses and water that nobody reads stay as they were
    thought to be."""
    out = np.tile(state, (len(temperatures) // len(state), 1))
    out[:, : temperatures.shape[1]] = temperatures
    return out


def separate_columns(slopes: Array, begins: tuple[int, ...]) -> Array:
    """Slopes (n, ..., k) of the temperatures at all beginnings at once as those (n, ..., s * k) of each by itself."""
    k = slopes.shape[-1]
    out = np.zeros((*slopes.shape[:-1], len(begins) * k))
    for i, rows in enumerate(segment_rows(begins, len(slopes))):
        out[rows, ..., i * k : (i + 1) * k] = slopes[rows]
    return out
