"""Times in which all tags of one interface are silent: gaps of its communication.

Tags that come through one interface (a PLC, a motor control centre, a weather mast) fall silent together. A silence
is a gap where the rates of the tags just before and after it make it improbable: with `r` samples expected of the
group and none seen, its chance is about exp(-r). The threshold follows from the group's own silences, whose `r` are
about exponential, so that a record of any length yields none by chance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin.historian.tags import Array, Defect, Series, longest_interval_s

LEAST_S = 600.0
LEAST_TAGS = 2
AROUND_S = (2400.0, 7200.0)
"""Times before and after a silence from which the rates are learned: the state of operation, not a season's."""
MARGIN = 4.0
"""Excess over the largest expected of the group's silences, in their scale: a chance of exp(-4) a group and record."""
STILL = 1.5
"""Factor on the threshold where no tag has another value after the silence than before it."""
JUMP = 3.0
"""Times the usual step between samples, from which a value is another one."""
RARE = 0.95
"""Share of a tag's own steps that one beyond them is a jump."""
TAIL = 0.9
"""Quantile of a group's silences that shows their scale: of a lively group with few silences some per cent are gaps."""
SURE = 12.0
"""Expected samples above which a single silence is improbable by itself: exp(-12)."""
WEATHER = frozenset(
    {
        "dry_bulb_temperature",
        "relative_humidity",
        "relative_humidity_redundant",
        "wet_bulb_temperature",
        "barometric_pressure",
        "wind_speed",
        "wind_direction",
    }
)


@dataclass(frozen=True)
class Group:
    """Tags of one interface."""

    tags: tuple[str, ...]


def interface_groups(series: Sequence[Series]) -> list[Group]:
    """Return the tags by interface: those of a usual wiring, and merged where their long silences coincide."""
    usual: dict[str, list[Series]] = {}
    for one in series:
        if len(one.time_s):
            usual.setdefault(_usual_interface(one), []).append(one)
    silences = {key: [_clear_silences(one) for one in members] for key, members in usual.items()}
    own = {key: _common(spans) for key, spans in silences.items()}
    keys = list(usual)
    label = {key: key for key in keys}
    for k, first in enumerate(keys):
        for second in keys[k + 1 :]:
            if len(own[first]) >= 3 and len(own[second]) >= 3 and _coincide(own[first], own[second]):
                old, new = label[second], label[first]
                label = {key: new if value == old else value for key, value in label.items()}
    merged: dict[str, list[str]] = {}
    for key in keys:
        merged.setdefault(label[key], []).extend(one.tag.name for one in usual[key])
    return [Group(tuple(members)) for members in merged.values()]


def communication_gaps(
    series: Sequence[Series], groups: Sequence[Group], known: Mapping[str, Sequence[tuple[float, float]]]
) -> list[Defect]:
    """Return the gaps of communication: of everything first, then of each interface.

    Parameters
    ----------
    series
        Usable samples.
    groups
        Tags by interface.
    known
        Spans by tag that have no samples for another reason.
    """
    by_name = {one.tag.name: one for one in series if len(one.time_s)}
    found: list[Defect] = []
    everything = Group(tuple(by_name))
    for group in (everything, *(group for group in groups if set(group.tags) != set(by_name))):
        members = [by_name[name] for name in group.tags if name in by_name]
        for start, end in _silences(members):
            if any(d.start_s < end and start < d.end_s and set(group.tags) <= set(d.tags) for d in found):
                continue
            if any(low < end and start < high for name in group.tags for low, high in known.get(name, ())):
                continue
            minutes = (end - start) / 60.0
            says = f"{len(members)} tags silent together for {minutes:.0f} min"
            names = tuple(one.tag.name for one in members)
            found.append(Defect("comms_gap", names, start, end, says, "left out"))
    return found


def _usual_interface(series: Series) -> str:
    role = series.tag.role
    if role in WEATHER:
        return "weather mast"
    if role.startswith("fan_") or role == "pump_power":
        return "motor control centre"
    return f"cell {series.tag.cell}"


def _silences(members: Sequence[Series]) -> list[tuple[float, float]]:
    """Return the spans in which nothing of the group came, though by its rates something should have."""
    if len(members) < LEAST_TAGS:
        return []
    union = np.sort(np.concatenate([one.time_s for one in members]))
    interval = np.diff(union)
    rows = np.flatnonzero(interval >= min(LEAST_S, 300.0))
    if len(rows) == 0:
        return []
    start, end = union[rows], union[rows + 1]
    length = end - start
    # At a change of operation the quieter side, and the quieter of the near and the far time, is the one that counts.
    rate = np.full(len(rows), np.inf)
    for window in AROUND_S:
        for low, high in ((start - window, start), (end, end + window)):
            seen = np.zeros(len(rows))
            for one in members:
                seen += _count(one.time_s, low, high)
            rate = np.minimum(rate, seen / window)
    expected = length * rate
    largest, scale = SURE, 1.0
    if len(rows) > 50:
        # Silences that are no gaps: the tail of r is about exponential, the largest of n at log n scales above it.
        middle, far = np.quantile(expected, (0.5, TAIL))
        scale = max(float(far - middle) / np.log(0.5 / (1.0 - TAIL)), 1.0)
        largest = max(SURE, float(middle) + scale * np.log(0.5 * len(rows)))
    found = []
    for k in np.flatnonzero((expected >= largest) & (length >= LEAST_S)):
        jumped = _jumps(members, float(start[k]), float(end[k]))
        wanted = largest if jumped >= 2 else largest + MARGIN * scale if jumped else STILL * (largest + MARGIN * scale)
        if expected[k] >= wanted:
            found.append((float(start[k]), float(end[k])))
    return found


def _jumps(members: Sequence[Series], start: float, end: float) -> int:
    """Return how many tags have another value after a silence than before it, by far more than between samples.

    An archive by exception stores what leaves the deviation, with the value before it. So it has small steps across a
    real standstill, and large ones where nothing could be stored.
    """
    found = 0
    for one in members:
        after = int(np.searchsorted(one.time_s, end - 1e-3, side="left"))
        if not 0 < after < len(one.time_s) or one.time_s[after - 1] > start + 1e-3:
            continue
        steps = np.abs(np.diff(one.value))
        steps = steps[steps > 0.0]
        # Steps have heavy tails: of seven tags two would have some, one time in six.
        large = max(JUMP * float(np.median(steps)), float(np.quantile(steps, RARE))) if len(steps) else np.inf
        found += abs(one.value[after] - one.value[after - 1]) > large
    return found


def _count(time_s: Array, low: Array, high: Array) -> Array:
    return np.asarray(
        np.searchsorted(time_s, high, side="right") - np.searchsorted(time_s, low, side="left"), dtype=np.float64
    )


def _clear_silences(series: Series) -> Array:
    """Return starts and ends (k, 2) of silences that are longer than the tag ever is silent by itself."""
    if len(series.time_s) < 20:
        return np.zeros((0, 2))
    interval = np.diff(series.time_s)
    rows = np.flatnonzero(interval > 1.2 * longest_interval_s(series))
    return np.stack([series.time_s[rows], series.time_s[rows + 1]], axis=1)


def _common(spans: Sequence[Array]) -> Array:
    """Return the silences of one tag that most of its group share."""
    if len(spans) < LEAST_TAGS:
        return np.zeros((0, 2))
    longest = max(spans, key=len)
    shared = [span for span in longest if sum(bool(len(o) and _overlaps(span, o)) for o in spans) > 0.5 * len(spans)]
    return np.asarray(shared).reshape(-1, 2)


def _overlaps(span: Array, others: Array) -> bool:
    common = np.minimum(span[1], others[:, 1]) - np.maximum(span[0], others[:, 0])
    return bool((common > 0.6 * (span[1] - span[0])).any())


def _coincide(first: Array, second: Array) -> bool:
    """Return whether nearly all silences of either lie where the other has some."""
    hits = [_overlaps(span, second) for span in first] + [_overlaps(span, first) for span in second]
    return sum(hits) >= 0.8 * len(hits)
