"""Clocks of a store that were set wrong for a time: stamps go back by hours, and jump as far ahead at its other end.

The order in which a historian stores its samples shows both. A clock that is set back ends with a jump ahead, and one
that is set ahead begins with it. Falls of an hour or less are left to the search for local time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.historian.tags import Array, Defect, Series, longest_interval_s

LEAST_S = 3900.0
"""Least fall, s: a clock of local time falls by an hour where summer time ends."""
FEWEST_TAGS, SHARE = 3, 0.5
"""Tags, and share of them, whose stamps fall together where the clock of a store was set."""
REGULAR = 3
"""The third of the tags with the shortest intervals tells when a clock was set, and by how much."""
APART_S = 3600.0
"""Longest time between the falls of two tags by one setting of the clock, beside their intervals, s."""


@dataclass(frozen=True)
class _Setting:
    """Clock that was off by `by_s`, and the stamps that it gave at the beginning and end of that time, s.

    `fell_s` is the stamp before which all tags fall.
    """

    fell_s: float
    by_s: float
    start_s: float
    end_s: float


def with_clock_steps_undone(series: Sequence[Series]) -> tuple[list[Series], list[Defect]]:
    """Return the series with the stamps that a clock gave while it was set wrong moved back, and the defects.

    Parameters
    ----------
    series
        Raw samples in the order of storing.
    """
    by_interval = sorted((one for one in series if len(one.time_s)), key=longest_interval_s)
    regular = by_interval[: max(len(by_interval) // REGULAR, min(FEWEST_TAGS, len(by_interval)))]
    found, defects = list(series), []
    for setting in _agreed([_settings_of(one) for one in regular]):
        spans = {j: span for j, one in enumerate(series) if (span := _span(one, setting)) is not None}
        if len(spans) < max(FEWEST_TAGS, SHARE * len(series)):
            continue
        for j, (first, last) in spans.items():
            moved = found[j].time_s.copy()
            moved[first : last + 1] += setting.by_s
            found[j] = replace(found[j], time_s=moved)
        defects.append(_defect([series[j].tag.name for j in spans], setting))
    return found, defects


def _settings_of(series: Series) -> list[_Setting]:
    """Return the settings of the clock that a tag shows: falls of its stamps, each with the jump ahead that undoes it,
    or that it undoes."""
    time_s, step = series.time_s, np.diff(series.time_s)
    usual, longest = _usual_s(step), longest_interval_s(series)
    found = []
    for k in np.flatnonzero(step < -LEAST_S):
        # The jump is longer by an interval than the clock was set by, the fall is shorter.
        jumps = np.flatnonzero(np.abs(step + step[k] - 2.0 * usual) <= longest)
        after, before = jumps[jumps > k], jumps[jumps < k]
        if len(after):
            by_s = 0.5 * float(step[after[0]] - step[k])
            found.append(_Setting(float(time_s[k]), by_s, float(time_s[k + 1]), float(time_s[after[0]])))
        elif len(before):
            by_s = 0.5 * float(step[k] - step[before[-1]])
            found.append(_Setting(float(time_s[k]), by_s, float(time_s[before[-1] + 1]), float(time_s[k])))
    return found


def _usual_s(step: Array) -> float:
    ahead = step[step > 0.0]
    return float(np.median(ahead)) if len(ahead) else 0.0


def _agreed(of_tags: Sequence[list[_Setting]]) -> list[_Setting]:
    """Return the settings of the clock that most of some tags show, with the means of what these show."""
    left = sorted((one for found in of_tags for one in found), key=lambda one: one.fell_s)
    agreed = []
    while left:
        first = left[0]
        alike = [one for one in left if one.fell_s - first.fell_s <= APART_S and _is_like(one, first)]
        left = [one for one in left if one not in alike]
        if len(alike) > SHARE * len(of_tags):
            fell, by, start, end = (
                np.array([[one.fell_s, one.by_s, one.start_s, one.end_s] for one in alike]).mean(axis=0).tolist()
            )
            agreed.append(_Setting(fell, 60.0 * round(by / 60.0), start, end))
    return agreed


def _is_like(one: _Setting, other: _Setting) -> bool:
    return abs(one.by_s - other.by_s) <= APART_S and abs(one.end_s - other.end_s) <= APART_S


def _span(series: Series, setting: _Setting) -> tuple[int, int] | None:
    """Return the first and last sample of a tag that a clock stamped while it was off; None where no fall shows it.

    The fall of a tag with long intervals is shorter by one of these.
    """
    time_s, near = series.time_s, APART_S + longest_interval_s(series)
    falls = np.flatnonzero((np.diff(time_s) < 0.0) & (np.abs(time_s[:-1] - setting.fell_s) <= near))
    if not len(falls):
        return None
    fall, half = int(falls[0]), 0.5 * abs(setting.by_s)
    if setting.by_s > 0.0:
        after = np.flatnonzero(time_s[fall + 1 :] > setting.end_s + half)
        return fall + 1, fall + int(after[0]) if len(after) else len(time_s) - 1
    before = np.flatnonzero(time_s[: fall + 1] < setting.start_s - half)
    return int(before[-1]) + 1 if len(before) else 0, fall


def _defect(tags: list[str], setting: _Setting) -> Defect:
    way = "behind" if setting.by_s > 0.0 else "ahead"
    minutes = abs(setting.by_s) / 60.0
    says = f"the stamps of {len(tags)} tags were {minutes:.0f} min {way}: the clock was set, and set again"
    start_s, end_s = setting.start_s + setting.by_s, setting.end_s + setting.by_s
    return Defect("clock_offset", tuple(sorted(tags)), start_s, end_s, says, "shifted to UTC")
