"""Tags side by side on one grid, and the prediction of one from the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from twin.historian.tags import Array, Mask, Series, longest_interval_s
from twin.historian.units import unit_of

STEP_S = 900.0
"""Fine beside a basin's and a day's time constants, coarse beside the samples' two to five minutes."""
ROUNDS = 4
BASIN, OUTLET = "basin_temperature", "water_outlet_temperature"
OF_WATER = ("water_inlet_temperature", OUTLET, BASIN)
"""Thermometers of a cell that show the plant's water only while it flows."""
SMALLEST_WORK = 0.1
"""Share of the 95 % quantile of a flow, power or pressure below which it is at rest."""


@dataclass(frozen=True)
class TagPanel:
    """Values of tags in the record's units (tags, m) at times `grid_s (m,)`; NaN where unknown."""

    series: tuple[Series, ...]
    grid_s: Array
    values: Array

    def between(self, rows: slice) -> TagPanel:
        """Return the values of some rows."""
        return TagPanel(self.series, self.grid_s[rows], self.values[:, rows])


def panel(series: Sequence[Series], step_s: float = STEP_S) -> TagPanel:
    """Return the tags with at least two samples on a grid over their common span."""
    usable = tuple(one for one in series if len(one.time_s) > 1)
    if not usable:
        return TagPanel((), np.zeros(0), np.zeros((0, 0)))
    start, end = min(one.time_s[0] for one in usable), max(one.time_s[-1] for one in usable)
    grid = np.arange(np.ceil(start / step_s) * step_s, end, step_s)
    return TagPanel(usable, grid, np.stack([on_grid(one, grid) for one in usable]))


def on_grid(series: Series, grid_s: Array) -> Array:
    """Return a tag in the record's unit at `grid_s`."""
    unit = unit_of(series.tag.unit)
    return np.asarray(unit.scale * series.at(grid_s, 1.2 * longest_interval_s(series)) + unit.offset)


def stands(one: Series, others: Sequence[Series], time_s: Array) -> Mask:
    """Return the times (n,) at which no water passes a cell's thermometer of water, so that no other tag follows it.

    The state of the cell tells it, or its flow; where neither is known, it is taken to work.
    """
    own = one.tag
    none = np.zeros(len(time_s), dtype=bool)
    if own.role not in OF_WATER or own.cell is None:
        return none
    of_cell = {other.tag.role: other for other in others if other.tag.cell == own.cell and len(other.time_s) > 1}
    other = of_cell.get("cell_in_service", of_cell.get("water_flow"))
    if other is None:
        return none
    value = np.abs(other.at(time_s, 1.2 * longest_interval_s(other)))
    state = other.tag.role == "cell_in_service"
    rest = 0.5 if state else SMALLEST_WORK * float(np.quantile(np.abs(other.value), 0.95))
    return np.asarray(value < rest)


def basin_inflows(table: TagPanel, without: Sequence[int]) -> Array:
    """Return what a thermometer of a basin follows beside the tags of its own cell (k, m), in K and degC.

    The water of a basin comes from all of its cells: of each, the outlet above the basin as a whole where its water
    flows, and 0 where it stands; and the other cells' thermometers of the basin. `without`: tags that are judged.
    """
    use = [j for j in range(len(table.series)) if j not in without]
    basins = [j for j in use if table.series[j].tag.role == BASIN]
    whole = [j for j in use if table.series[j].tag.role == "supply_temperature"] or basins
    rows = [table.values[j] for j in basins]
    if whole:
        known = np.isfinite(table.values[whole])
        total = np.where(known, table.values[whole], 0.0).sum(axis=0)
        level = np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), np.nan)
        for j in use:
            if table.series[j].tag.role == OUTLET:
                rows.append(np.where(stands(table.series[j], table.series, table.grid_s), 0.0, table.values[j] - level))
    return np.stack(rows) if rows else np.zeros((0, len(table.grid_s)))


def design_matrix(values: Array) -> Array:
    """Return what predicts (m, k + 1): ones, and the rows of `values (k, m)` standardised, the unknown at their
    mean."""
    known = np.isfinite(values)
    count = np.maximum(known.sum(axis=1, keepdims=True), 1)
    filled = np.where(known, values, 0.0)
    mean = filled.sum(axis=1, keepdims=True) / count
    apart = np.where(known, values - mean, 0.0)
    scale = np.sqrt((apart**2).sum(axis=1, keepdims=True) / count)
    use = (scale[:, 0] > 0.0) & (known.mean(axis=1) > 0.5)
    return np.concatenate([np.ones((values.shape[1], 1)), (apart[use] / scale[use]).T], axis=1)


class RobustPredictor:
    """Ridge predictions by one matrix with Huber weights, of targets that are known in the same rows for the most part.

    Most rows have the weight 1. So the products of all rows are kept, and those of the few with less are taken off.
    """

    def __init__(self, matrix: Array) -> None:
        """Predict by `matrix (m, k)`."""
        self.matrix = np.ascontiguousarray(matrix)
        self._known: Mask = np.zeros(0, dtype=bool)
        self._rows, self._gram = self.matrix[:0], np.zeros((0, 0))

    def __call__(self, target: Array, rounds: int = ROUNDS) -> tuple[Array, float]:
        """Return the prediction (m,) of `target (m,)`, and its scatter."""
        known = np.isfinite(target)
        count, k = int(np.count_nonzero(known)), self.matrix.shape[1]
        if count < 2 * k:
            return np.full(len(target), np.nan), np.inf
        if not np.array_equal(known, self._known):
            rows = self.matrix if count == len(known) else self.matrix.compress(known, axis=0)
            gram = rows.T @ rows
            ridge = np.full(k, 1e-3 * count)
            ridge[0] = 1e-9
            gram.ravel()[:: k + 1] += ridge
            self._known, self._rows, self._gram = known, rows, gram
        rows = self._rows
        centre = _median(target[known])
        y = target[known] - centre
        gram, weighted = self._gram, y
        predicted, sigma = y, np.inf
        for left in range(rounds, 0, -1):
            _, coefficients, failed = dposv(gram, weighted @ rows)
            if failed:
                raise np.linalg.LinAlgError("the tags that predict have a value that is no number")
            predicted = rows @ coefficients
            off = np.abs(y - predicted)
            sigma = max(1.4826 * _median(off), 1e-6)
            if left == 1:
                break
            far = np.flatnonzero(off > 1.5 * sigma)
            weight = 1.5 * sigma / off[far]
            lost = rows.take(far, axis=0) * np.sqrt(1.0 - weight)[:, None]
            gram = self._gram - lost.T @ lost
            weighted = y.copy()
            weighted[far] *= weight
        if count < len(known):
            predicted = self.matrix @ coefficients
        return np.asarray(centre + predicted), sigma


def _median(values: Array) -> float:
    """Return the median of numbers (m,), m > 0; of some hundred `np.median` spends its time on other cases."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    parted = np.partition(values, (half - 1, half))
    return 0.5 * float(parted[half - 1] + parted[half])


def known_median(values: Array) -> float:
    """Return the median of the known of some values (m,), NaN where there is none; `np.nanmedian` takes ten times as
    long for a few."""
    known = values[~np.isnan(values)]
    return _median(known) if len(known) else np.nan


def upper_quartile(values: Array) -> float:
    """Return the quantile 0.75 of numbers (m,), m > 0, as `np.quantile` does, which takes twice as long for some
    thousand."""
    at = 0.75 * (len(values) - 1)
    low = int(at)
    share, high = at - low, min(low + 1, len(values) - 1)
    parted = np.partition(values, (low, high))
    step = float(parted[high]) - float(parted[low])
    # The form of the interpolation that `np.quantile` takes, to the last digit.
    return float(parted[high]) - step * (1.0 - share) if share >= 0.5 else float(parted[low]) + step * share


def largest_sum(gain: Array) -> tuple[int, int, float]:
    """Return begin, end (exclusive) and value of the run with the largest sum (Kadane's algorithm)."""
    total = np.concatenate([[0.0], np.cumsum(gain)])
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    low = int(np.argmin(total[: end + 1]))
    return low, max(end, low + 1), float(total[end] - total[low])


def moving_mean(x: Array, half: int) -> Array:
    """Return the mean (m,) of what is known in each value of `x (m,)` and the `half` values on either side of it."""
    known = np.isfinite(x)
    total = np.concatenate([[0.0], np.cumsum(np.where(known, x, 0.0))])
    count = np.concatenate([[0], np.cumsum(known)])
    low = np.maximum(np.arange(len(x)) - half, 0)
    high = np.minimum(np.arange(len(x)) + half + 1, len(x))
    n = count[high] - count[low]
    return np.asarray(np.where(n > 0, (total[high] - total[low]) / np.maximum(n, 1), np.nan))
