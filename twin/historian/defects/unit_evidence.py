"""Evidence of the rows of a tag for a span in another unit.

Over the span the converted values go with the other tags of the plant, and the values as they stand do not. The
witness is the prediction by all tags that do not leap at the same time. A real step of operation moves its witnesses,
and has no factor of a unit; another range of the transmitter has any factor.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student_t

from twin.historian.defects.panel import RobustPredictor, known_median
from twin.historian.tags import Array, Mask

ROWS_AN_HOUR = 4.0
"""Rows of a panel in an hour, after which an error is a new one at the earliest."""
CLEAR, CLEAR_ENOUGH = 0.25, 0.5
"""Largest median distance from the prediction, of the right unit, as a share of that of the wrong one; and with sure
edges."""
MOSTLY = 0.8
"""Share of the rows in which the right unit is nearer."""
OUTSIDE = 0.7
"""The same as `CLEAR` of the longer of the two, the span and the rest: there small values of a poorly predicted tag,
such as the wind, tell little."""
EXPLAINS = 0.3
"""Share of what the switch moves, in the span or the rest, if shorter, by which all rows are worse predicted without
it."""
OTHER_FACTOR, SCATTERS = 0.12, 2.0
"""Share of what the switch moves, and deviations of the rows, by which the converted span may be apart from the rest:
5 % of a fan's speed in Hz, 4 % of a power in hp."""
SPANS = float(np.log(2.0))
"""Standard deviation of the logarithm of the factor of a changed range: usually a half to a double span."""
PARTS = 3, 5
"""Parts of the record outside a span, about as long as it, by which a factor is known: fewest and most."""
ROUNDED = 0.005
"""Scatter of a factor at best: converted values are stored with two or three digits."""
TWENTY_TO_ONE = 3.0
"""Log odds from which a factor is that of a unit (Kass & Raftery); below, nothing is converted."""
FEWEST_ROWS = 8
"""Rows of a quarter of an hour at work by which a span is judged: two hours, the shortest span."""
AT_REST = 0.1
"""Share of the largest change by a unit below which a row tells nothing of it: the quantity is at rest."""
ROUNDS = 3
"""Rounds in which a prediction is made anew after the values have changed."""


def is_of_the_unit(x: Array, converted: Array, inside: Mask, witnesses: Array) -> bool:
    """Return whether a span of a tag is in another unit rather than in another range of any factor.

    A unit's factor is exact. The factor that the span needs beyond it is known as well as that of other parts of the
    record, which need none (Student's distribution). A range's factor is as probable as `SPANS` has it.

    Parameters
    ----------
    x, converted
        Readings (m,) as they stand, and as converted from the other unit by its factor.
    inside
        Rows of the span (m,).
    witnesses
        What predicts the tag (m, k).
    """
    value = np.where(inside, converted, x)
    if not np.isfinite(value).any():
        return False
    value = np.where(value > AT_REST * float(np.nanquantile(value, 0.95)), value, np.nan)
    span, rest = (np.flatnonzero(np.isfinite(value) & part) for part in (inside, ~inside))
    if len(span) < FEWEST_ROWS or len(rest) < FEWEST_ROWS * PARTS[0]:
        return False
    predict = RobustPredictor(witnesses)
    apart = _log_factor(value, span, predict)
    if not np.isfinite(apart):
        return False
    right = np.where(inside, np.nan, value)
    parts = np.array_split(rest, int(np.clip(len(rest) // len(span), *PARTS)))
    usual = 1.4826 * known_median(np.abs([_log_factor(right, part, predict) for part in parts]))
    scale = max(usual, ROUNDED)
    ratio = float(np.log(known_median(x[span] / converted[span])))
    of_unit = student_t.logpdf(apart / scale, len(parts)) - np.log(scale)
    return bool(of_unit - norm.logpdf(ratio + apart, scale=SPANS) >= TWENTY_TO_ONE)


def _log_factor(value: Array, rows: NDArray[np.intp], predict: RobustPredictor) -> float:
    """Return the logarithm of the factor of some rows of values (m,) over what the others and the witnesses predict;
    infinite if they predict nothing above zero there."""
    factor = 0.0
    for _ in range(ROUNDS + 1):
        again = value.copy()
        again[rows] *= np.exp(-factor)
        predicted, _ = predict(again)
        there = predicted[rows]
        if not (there > 0.0).any():
            return np.inf
        factor = float(np.median(np.log(value[rows][there > 0.0] / there[there > 0.0])))
    return factor


def rows_inside(n: int, rows: tuple[int, int]) -> Mask:
    """Return True (n,) for the rows from the first to before the last."""
    mask = np.zeros(n, dtype=bool)
    mask[rows[0] : rows[1]] = True
    return mask


def evidence_of_rows(
    x: Array, other: Array, fits: tuple[Array, Array], inside: Mask, slope: float, sure: bool
) -> float:
    """Return the evidence of the rows for a switch; none if the converted values do not go with their prediction.

    The evidence is a log likelihood ratio of Cauchy's distribution about the prediction with the switch to that
    without. Rows whose errors are alike count once.

    Parameters
    ----------
    x, other
        Readings (m,) as they stand, and converted.
    fits
        Predictions (m,) of the values as they stand, and with the span converted.
    inside
        Rows of the span (m,).
    slope
        Factor of the conversion, by which the density of the values changes.
    sure
        The edges are sure by themselves.
    """
    plain, predicted = fits
    right, wrong = np.where(inside, other, x) - predicted, np.where(inside, x, other) - predicted
    before = x - plain
    known = np.isfinite(before) & np.isfinite(right) & np.isfinite(other)
    moved = np.abs(x - other)
    parts = [known & part for part in (inside, ~inside)]
    work = [part & (moved > AT_REST * np.max(moved[part], initial=0.0)) for part in parts]
    small = int(work[1].sum() < work[0].sum())
    limits = (CLEAR_ENOUGH if sure else CLEAR, MOSTLY), (OUTSIDE, 0.5)
    for rows, (limit, mostly) in zip((work[small], work[1 - small]), limits, strict=True):
        if not _clear(right[rows], wrong[rows], limit, mostly):
            return -np.inf
    # Another factor than the unit's leaves the span apart from the rest: that is a change of range.
    apart = abs(float(np.median(right[work[0]]) - np.median(right[work[1]])))
    scatter = max(float(np.median(np.abs(right[part] - np.median(right[part])))) for part in work)
    if apart > max(OTHER_FACTOR * float(np.median(moved[work[0]])), SCATTERS * scatter):
        return -np.inf
    # Witnesses that moved as the tag did explain it as it stands.
    at_work = work[0] | work[1]
    gained = float(np.abs(before[at_work]).sum() - np.abs(right[at_work]).sum())
    if gained < EXPLAINS * float(moved[work[0]].mean()) * float(work[small].sum()):
        return -np.inf
    ratio = _surprise(before[at_work]) - _surprise(right[at_work]) + float(work[0].sum()) * np.log(slope)
    return ratio / _rows_alike(right[known])


def _surprise(error: Array) -> float:
    """Return the sum of minus the log density of errors, by Cauchy's distribution of their own scale."""
    scale = max(float(np.median(np.abs(error))), 1e-9)
    return float(np.sum(np.log(scale) + np.log1p((error / scale) ** 2)))


def _rows_alike(error: Array) -> float:
    """Return after how many rows an error is a new one: at least an hour, more if it lasts."""
    far = 3.0 * max(float(np.median(np.abs(error))), 1e-9)
    small = np.clip(error, -far, far)
    small = small - small.mean()
    power = float((small**2).sum())
    alike = float((small[1:] * small[:-1]).sum()) / power if power > 0.0 else 0.0
    alike = min(max(alike, 0.0), 0.999)
    return max((1.0 + alike) / (1.0 - alike), ROWS_AN_HOUR)


def _clear(right: Array, wrong: Array, limit: float, mostly: float) -> bool:
    """Return whether the values in the right unit lie near the prediction, those in the wrong one far off."""
    if len(right) < FEWEST_ROWS:
        return False
    near, far = float(np.median(np.abs(right))), float(np.median(np.abs(wrong)))
    return near < limit * far and float(np.mean(np.abs(right) < np.abs(wrong))) > mostly
