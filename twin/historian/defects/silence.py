"""Times in which all tags of one interface are silent: gaps of its communication.

Tags that come through one interface (a PLC, a motor control centre, a weather mast) fall silent together. Which tags
these are is learned from their longest gaps; where none tells, the cell and the role do. The samples of a group together
come often, so that a short silence of all of them is seen, though each tag alone is silent as long at times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.historian.tags import Array, Defect, Series, longest_interval_s

LEAST_S = 600.0
LEAST_TAGS = 2
FAR = 4.0
"""Times the longest regular silence of the group, from which a silence is a gap."""
WEATHER = frozenset({"dry_bulb_temperature", "relative_humidity", "relative_humidity_redundant", "wet_bulb_temperature",
                     "barometric_pressure", "wind_speed", "wind_direction"})  # fmt: skip


@dataclass(frozen=True)
class Group:
    """Tags of one interface."""

    tags: tuple[str, ...]


def silent_groups(series: Sequence[Series]) -> tuple[list[Defect], list[Group]]:
    """Return the gaps of communication and the groups of tags that fall silent together."""
    groups = _groups(series)
    by_name = {one.tag.name: one for one in series}
    found: list[Defect] = []
    everything = Group(tuple(by_name))
    for group in (everything, *groups):
        members = [by_name[name] for name in group.tags if len(by_name[name].time_s)]
        for start, end in _silences(members):
            if not any(d.start_s <= start + LEAST_S and d.end_s >= end - LEAST_S for d in found):
                minutes = (end - start) / 60.0
                says = f"{len(group.tags)} tags silent together for {minutes:.0f} min"
                found.append(Defect("comms_gap", group.tags, start, end, says, "left out"))
    return found, groups


def _silences(members: Sequence[Series]) -> list[tuple[float, float]]:
    """Return the spans in which nothing of the group came, though something should have."""
    if len(members) < LEAST_TAGS:
        return []
    union = np.unique(np.concatenate([one.time_s for one in members]))
    intervals = np.diff(union)
    usual = float(np.quantile(intervals, 0.999)) if len(intervals) > 100 else float(intervals.max(initial=0.0))
    # A gap is itself among the intervals: the 99.9 % of a short record may be one.
    usual = min(usual, 10.0 * float(np.quantile(intervals, 0.9))) if len(intervals) else usual
    limit = max(LEAST_S, FAR * usual)
    return [(float(union[k]), float(union[k + 1])) for k in np.flatnonzero(intervals > limit)]


def _groups(series: Sequence[Series]) -> list[Group]:
    """Return groups by gaps that tags have in common, and by cell and role for tags without any."""
    gaps = {one.tag.name: _clear_gaps(one) for one in series}
    parent = {name: name for name in gaps}

    def root(name: str) -> str:
        while parent[name] != name:
            name = parent[name]
        return name

    names = list(gaps)
    for k, first in enumerate(names):
        for second in names[k + 1 :]:
            if _coincide(gaps[first], gaps[second]):
                parent[root(first)] = root(second)
    clusters: dict[str, list[str]] = {}
    for name in names:
        clusters.setdefault(root(name), []).append(name)
    learned = [Group(tuple(members)) for members in clusters.values() if len(members) >= LEAST_TAGS]
    known = {name for group in learned for name in group.tags}
    guessed: dict[str, list[str]] = {}
    for one in series:
        if one.tag.name not in known:
            guessed.setdefault(_guess(one), []).append(one.tag.name)
    return learned + [Group(tuple(members)) for members in guessed.values() if len(members) >= LEAST_TAGS]


def _guess(series: Series) -> str:
    if series.tag.role in WEATHER:
        return "weather"
    return "fans" if series.tag.role.startswith("fan_") else f"cell {series.tag.cell}"


def _clear_gaps(series: Series) -> Array:
    """Return starts and ends (k, 2) of silences that are longer than the tag ever is silent by itself."""
    if len(series.time_s) < 20:
        return np.zeros((0, 2))
    intervals = np.diff(series.time_s)
    rows = np.flatnonzero(intervals > 1.2 * longest_interval_s(series))
    return np.stack([series.time_s[rows], series.time_s[rows + 1]], axis=1)


def _coincide(first: Array, second: Array) -> bool:
    """Return whether most of the clear gaps of the one with fewer lie where the other has some, and at least two do."""
    if len(first) == 0 or len(second) == 0:
        return False
    few, many = (first, second) if len(first) <= len(second) else (second, first)
    hits = 0
    for start, end in few:
        common = np.minimum(end, many[:, 1]) - np.maximum(start, many[:, 0])
        hits += bool((common > 0.6 * (end - start)).any())
    return hits >= max(1, round(0.6 * len(few)))
