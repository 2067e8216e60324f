"""Minutes from raw samples: time-weighted means, held commands, staleness, and how each minute came about.

Nothing is filled forward but commands and states. A minute of a measured quantity without a sample is interpolated

* between samples less than three minutes apart (`INTERPOLATED`), as the paper has it, and
* between samples up to the longest regular interval of the tag where its historian reports by exception
(`BY_EXCEPTION`).

The second is a departure from the paper. An archive with exception reporting and swinging-door compression stores no
sample while the value stays within its deviation, so the samples' silence is itself a measurement, as fine as the
deviation. With three minutes alone nearly no minute of such a tag would be valid. The longest regular interval is
learned from the tag (`longest_interval_s`). Both kinds are marked, so that a reader may leave either out.
"""

from __future__ import annotations

import enum

import numpy as np
from numpy.typing import NDArray

from twin.historian.tags import Array, Series

MINUTE_S = 60.0
SHORT_GAP_S = 180.0
"""Gap under which a minute is interpolated whatever the historian (the paper, section 3)."""
LEAST_COVER = 0.5
"""Share of a minute that must lie between samples of a gap that is not too long."""


class How(enum.IntEnum):
    """Origin of a minute's value."""

    MISSING = 0
    MEASURED = 1
    INTERPOLATED = 2
    BY_EXCEPTION = 3
    HELD = 4


Origin = NDArray[np.uint8]


def minute_edges(start_s: float, end_s: float) -> Array:
    """Return the edges (n + 1,) of the whole minutes from that of `start_s` to that of `end_s`, s."""
    first = np.floor(start_s / MINUTE_S)
    last = max(np.ceil(end_s / MINUTE_S), first + 1)
    return np.asarray(np.arange(first, last + 1) * MINUTE_S)


def mean_minutes(series: Series, edges_s: Array, limit_s: float) -> tuple[Array, Origin]:
    """Return the time-weighted mean of each minute (n,) and its origin.

    Parameters
    ----------
    series
        Usable samples, in the order of time, one a time.
    edges_s
        Edges of the minutes (n + 1,).
    limit_s
        Longest interval between samples that is interpolated.
    """
    n = len(edges_s) - 1
    how = np.zeros(n, dtype=np.uint8)
    time_s, value = series.time_s, series.value
    if len(time_s) < 2:
        return np.full(n, np.nan), how
    gap = np.diff(time_s)
    joined = (gap <= max(limit_s, SHORT_GAP_S)) & ~series.broken()
    # Integrals of value and of covered time up to each sample; within an interval the value is a straight line.
    level = value[0]
    area = np.concatenate([[0.0], np.cumsum(np.where(joined, gap * (0.5 * (value[1:] + value[:-1]) - level), 0.0))])
    cover = np.concatenate([[0.0], np.cumsum(np.where(joined, gap, 0.0))])
    at = np.clip(np.searchsorted(time_s, edges_s, side="right") - 1, 0, len(gap) - 1)
    into = np.where(joined[at], np.clip(edges_s - time_s[at], 0.0, gap[at]), 0.0)
    slope = (value[at + 1] - value[at]) / gap[at]
    area_at = area[at] + into * (value[at] - level + 0.5 * into * slope)
    cover_at = cover[at] + into
    # The last edge inside a gap that is too long sees all that lies before it.
    covered, mean = np.diff(cover_at), np.diff(area_at)
    enough = covered >= LEAST_COVER * MINUTE_S
    minutes = np.where(enough, level + mean / np.where(enough, covered, 1.0), np.nan)
    how[enough] = How.BY_EXCEPTION
    middle = edges_s[:-1] + 0.5 * MINUTE_S
    between = np.clip(np.searchsorted(time_s, middle, side="right") - 1, 0, len(gap) - 1)
    how[enough & (gap[between] < SHORT_GAP_S)] = How.INTERPOLATED
    how[enough & (_samples(time_s, edges_s) > 0)] = How.MEASURED
    return minutes, how


def held_minutes(series: Series, edges_s: Array, limit_s: float) -> tuple[Array, Origin]:
    """Return the value that a command or a state has at the middle of each minute (n,), and its origin.

    A command keeps its value until its next sample. Where that is later than `limit_s` the rest is unknown.
    """
    n = len(edges_s) - 1
    how = np.zeros(n, dtype=np.uint8)
    time_s = series.time_s
    if len(time_s) == 0:
        return np.full(n, np.nan), how
    middle = edges_s[:-1] + 0.5 * MINUTE_S
    at = np.searchsorted(time_s, middle, side="right") - 1
    known = at >= 0
    at = np.maximum(at, 0)
    following = np.minimum(at + 1, len(time_s) - 1)
    within = (middle - time_s[at] <= limit_s) & ((time_s[following] - time_s[at] <= limit_s) | (following == at))
    known &= within
    cut = np.append(series.broken(), False)
    known &= ~cut[at]
    how[known] = How.HELD
    how[known & (_samples(time_s, edges_s) > 0)] = How.MEASURED
    return np.where(known, series.value[at], np.nan), how


def staleness_min(series: Series, edges_s: Array) -> Array:
    """Return the minutes since the last raw sample at the end of each minute (n,); NaN before the first one."""
    if len(series.time_s) == 0:
        return np.full(len(edges_s) - 1, np.nan)
    at = np.searchsorted(series.time_s, edges_s[1:], side="left") - 1
    age = (edges_s[1:] - series.time_s[np.maximum(at, 0)]) / MINUTE_S
    return np.asarray(np.where(at >= 0, age, np.nan))


def _samples(time_s: Array, edges_s: Array) -> NDArray[np.int64]:
    """Return the number of samples in each minute."""
    return np.asarray(np.diff(np.searchsorted(time_s, edges_s, side="left")), dtype=np.int64)
