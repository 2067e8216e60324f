"""Tags that change their unit in the middle of the record.

A change of unit is a jump by the known map of two units at either end of a span (or at one, if the record ends
first), that no witness shares. Two kinds of evidence are added. At its edges the tag goes on as usual if converted,
and leaps as it stands (`unit_edges`). Over the span the converted values go with the other tags of the plant, and the
values as they stand do not; the prediction by all tags that do not leap at the same time is the witness. A real step
of operation has no factor of a unit, and moves its witnesses; one that had the factor would still move them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.historian.defects.panel import RobustPredictor, TagPanel, design_matrix, panel
from twin.historian.defects.unit_edges import Edge, TagLevels, unit_edges
from twin.historian.defects.unit_evidence import (
    AT_REST,
    MOSTLY,
    ROUNDS,
    evidence_of_rows,
    is_of_the_unit,
    rows_inside,
)
from twin.historian.tags import Array, Defect, Mask, Series
from twin.historian.units import Unit, alternatives, full_speed_of, tens, unit_of

LEAST_S = 2.0 * 3600.0
"""Length of a span at least, s."""
CAP = 0.75
"""Largest evidence of a quarter of an hour, a log likelihood ratio: 3 an hour, as neighbours are correlated."""
LEAST_ODDS = 12.0
"""Log odds of a switch, less those of the pairs of edges that are tried: 7 are a thousand to one; 5 more for the tags
and units of a station."""
SURE_EDGES = 8.0
"""Log odds of the edges alone from which a poor prediction of the span suffices."""
UNWITNESSED = ("wind_speed", "wind_direction")
"""Roles that nothing else at a station follows: only their edges count."""
LEAPS = 3.0
"""Log odds from which a jump of another tag at the same time makes it no witness."""
TOGETHER_S = 3600.0
"""Time within which jumps of two tags count as one, s: stores are written by the hour."""
VOLUME = frozenset({"L/s", "l/s", "m3/h", "m³/h", "m3/s", "L/min", "gpm"})
DECIMAL = frozenset({"mass flow", "power", "pressure"})
"""Dimensions whose scale may move by a decimal place: controllers hold whole numbers of such a quantity, and a table of
registers that is read with another number of places is ten times off. No other range is (`unit_evidence.SPANS`)."""
DECADE = 5.0
"""Factor from which the larger of two scales that the datasheet allows is taken."""
SAME = 0.97
"""Share of the log odds of the most probable unit, from which another is not told from it: the more common is named."""
STARTS = 3
"""Spans from which the likeliest one is sought; its prediction is made anew some times from each (`ROUNDS`)."""
MOST = 6
"""Rounds over all tags, so switches of a tag, at most."""


@dataclass(frozen=True)
class Switch:
    """A span in another unit: the defect, and the unit that the values have in it."""

    defect: Defect
    unit: Unit


@dataclass(frozen=True)
class _Span:
    """A span of a tag in a unit: first and last time, and log odds."""

    unit: Unit
    name: str
    start_s: float
    end_s: float
    odds: float


class TagEdges:
    """Edges of changes of unit of a station's tags, found once for each series."""

    def __init__(self, full_speed: str = "60 Hz") -> None:
        """Look for the units that a fan's speed may have by `full_speed`, its speed at 100 %, with its unit."""
        self.full_speed = full_speed
        self._found: dict[str, tuple[Series, list[tuple[str, Unit, list[Edge]]]]] = {}

    def of(self, series: Series) -> list[tuple[str, Unit, list[Edge]]]:
        """Return the units that a tag may have changed to, with the edges of such a change."""
        name = series.tag.name
        if name not in self._found or self._found[name][0] is not series:
            self._found[name] = series, _edges_of(series, self.full_speed)
        return self._found[name][1]


def unit_switches(series: Sequence[Series], full_speed: str = "60 Hz", edges: TagEdges | None = None) -> list[Switch]:
    """Return the spans in which tags are in another unit.

    Parameters
    ----------
    series
        Good samples of the tags, in the units of the dictionary.
    full_speed
        Speed of a fan at 100 %, with its unit: a share and a frequency are units of one quantity.
    edges
        Of an earlier search at the same `full_speed`, kept for the series that have not changed since.
    """
    found: list[Switch] = []
    series = list(series)
    edges = edges or TagEdges(full_speed)
    for _ in range(MOST):
        new = _switches(panel(series), edges)
        if not new:
            break
        found += new
        by_name = {one.defect.tags[0]: one for one in new}
        series = [converted(one, by_name[one.tag.name]) if one.tag.name in by_name else one for one in series]
    return found


def converted(series: Series, switch: Switch) -> Series:
    """Return the series with the values inside the switch in the dictionary's unit."""
    own, unit = unit_of(series.tag.unit), switch.unit
    inside = (series.time_s >= switch.defect.start_s) & (series.time_s <= switch.defect.end_s)
    again = (unit.scale * series.value + unit.offset - own.offset) / own.scale
    return replace(series, value=np.where(inside, again, series.value))


def turned(switch: Switch, series: Series, usual: tuple[float, float] | None) -> Switch:
    """Return a switch, or that of the rest of the record where the datasheet shows the span to be right.

    With one edge in the record, a span in another unit and the rest in the inverse one look alike. A span that the
    record begins with is right by itself, as the readings before a change are, unless the datasheet tells otherwise.

    Parameters
    ----------
    switch
        Of the tag.
    series
        Samples of the tag, in the unit of the dictionary.
    usual
        Values at work that the quantity has, in the record's unit; None where nobody knows.
    """
    own, time_s = unit_of(series.tag.unit), series.time_s
    inside = (time_s >= switch.defect.start_s) & (time_s <= switch.defect.end_s)
    if own.offset != 0.0 or switch.unit.offset != 0.0 or not inside.any():
        return switch
    # Of an end of the record at which the quantity was at rest, or that is shorter than any span, no unit is known.
    least = AT_REST * float(np.quantile(series.value[inside], 0.95)) * min(switch.unit.scale / own.scale, 1.0)
    works = series.value > least
    first = switch.defect.start_s - time_s[0] < LEAST_S or not works[time_s < switch.defect.start_s].any()
    last = time_s[-1] - switch.defect.end_s < LEAST_S or not works[time_s > switch.defect.end_s].any()
    if first == last:
        return switch
    inverse = next(
        (
            (name, unit)
            for name, unit in (alternatives(series.tag.unit) | tens(series.tag.unit)).items()
            if np.isclose(unit.scale * switch.unit.scale, own.scale**2, rtol=1e-2)
        ),
        None,
    )
    if inverse is None or not _rest_is_wrong(switch, series, inside, usual, begins=first):
        return switch
    rest = time_s[time_s > switch.defect.end_s] if first else time_s[time_s < switch.defect.start_s]
    says = f"{series.tag.name} is in {inverse[0]} instead of {series.tag.unit}"
    defect = replace(switch.defect, start_s=float(rest[0]), end_s=float(rest[-1]), says=says)
    return Switch(defect, inverse[1])


def _rest_is_wrong(
    switch: Switch, series: Series, inside: Mask, usual: tuple[float, float] | None, *, begins: bool
) -> bool:
    """Return whether the rest of a record is in another unit, and not the span `inside` (n,), with which it `begins` or
    else ends."""
    if usual is None:
        return begins
    own, factor = unit_of(series.tag.unit), switch.unit.scale / unit_of(series.tag.unit).scale
    shares, tops = [], []
    for value in (np.where(inside, factor, 1.0), np.where(inside, 1.0, 1.0 / factor)):
        reading = own.scale * value * series.value
        top = float(np.quantile(reading, 0.95))
        work = reading[reading > AT_REST * top]
        shares.append(float(((work >= usual[0]) & (work <= usual[1])).mean()) if len(work) else 0.0)
        tops.append(top)
    if max(shares) >= MOSTLY and min(shares) <= 1.0 - MOSTLY:
        return shares[1] > shares[0]
    if max(factor, 1.0 / factor) >= DECADE:
        # A machine does not work above what it is made for, and seldom at a tenth of it.
        possible = [top if top <= usual[1] else 0.0 for top in tops]
        return possible[1] > possible[0]
    return begins and shares[1] >= shares[0]


def _switches(table: TagPanel, edges_of: TagEdges) -> list[Switch]:
    """Return the most probable switch of each tag that has one."""
    edges = [edges_of.of(one) for one in table.series]
    leaps = [
        np.array(sorted({e.after_s for _, _, found in of_tag for e in found if e.odds >= LEAPS})) for of_tag in edges
    ]
    found = []
    for k, one in enumerate(table.series):
        if not edges[k]:
            continue
        spans = []
        predictors: dict[tuple[int, ...], _Witnesses] = {}
        for name, unit, of_unit in edges[k]:
            at = [max((e.odds, e.after_s) for e in of_unit if e.into is way)[1] for way in _ways(of_unit)]
            drivers = tuple(j for j in range(len(leaps)) if j != k and not _leaps_too(leaps[j], at))
            if drivers not in predictors:
                predictors[drivers] = _Witnesses(table, k, drivers)
            if (span := _best_span(table, k, name, unit, of_unit, predictors[drivers])) is not None:
                spans.append(span)
        if spans:
            most = max(span.odds for span in spans)
            best = next(span for span in spans if span.odds >= SAME * most)
            says = f"{one.tag.name} is in {best.name} instead of {one.tag.unit}"
            defect = Defect("unit_switch", (one.tag.name,), best.start_s, best.end_s, says, "converted")
            found.append(Switch(defect, best.unit))
    return found


def _edges_of(series: Series, full_speed: str) -> list[tuple[str, Unit, list[Edge]]]:
    """Return the units that a tag may have changed to, with the edges of such a change."""
    own = unit_of(series.tag.unit)
    if own.dimension == "state":
        return []
    found = []
    seen: set[tuple[float, float]] = set()
    levels = TagLevels(series)
    for name, unit in other_units(series, full_speed).items():
        key = (round(float(np.log(unit.scale)), 2), round(unit.offset, 1))
        if key not in seen and (edges := unit_edges(levels, own, unit)):
            found.append((name, unit, edges))
            seen.add(key)
    return found


def other_units(series: Series, full_speed: str) -> dict[str, Unit]:
    """Return the units that the tag might switch to, of the same kind first; a fan's share and speed are one."""
    others = dict(alternatives(series.tag.unit))
    own = unit_of(series.tag.unit)
    full, speed = full_speed_of(full_speed)
    if series.tag.role.startswith("fan_speed"):
        if own.dimension == "share":
            others[next(name for name in ("Hz", "rpm") if unit_of(name) == speed)] = Unit("share", 100.0 / full)
        elif own.dimension == speed.dimension:
            others |= {"%": Unit(own.dimension, full / 100.0), "1": Unit(own.dimension, full)}
    volume = series.tag.unit in VOLUME
    others = dict(sorted(others.items(), key=lambda item: (item[0] in VOLUME) != volume))
    return others | (tens(series.tag.unit) if own.dimension in DECIMAL and own.offset == 0.0 else {})


def _ways(edges: Sequence[Edge]) -> list[bool]:
    return sorted({edge.into for edge in edges})


def _leaps_too(leaps_s: Array, at_s: Sequence[float]) -> bool:
    """Return whether a tag leaps within an hour of every one of some times: it may have changed its unit as well."""
    return bool(len(leaps_s)) and all(np.abs(leaps_s - one).min() <= TOGETHER_S for one in at_s)


class _Witnesses:
    """Prediction of a tag by some of the others, `plain` that of its values as they stand."""

    def __init__(self, table: TagPanel, k: int, drivers: Sequence[int]) -> None:
        self.predict = RobustPredictor(witnesses_of(table, k, drivers))
        self.plain = self.predict(table.values[k])


def witnesses_of(table: TagPanel, k: int, drivers: Sequence[int]) -> Array:
    """Return what predicts a tag: the other tags, and the laws that tie a fan's power to its speed."""
    drivers = [j for j in drivers if unit_of(table.series[j].tag.unit).dimension != "angle"]
    rows = [table.values[j] for j in drivers]
    role = table.series[k].tag.role
    for j in drivers:
        if role.endswith("power") and table.series[j].tag.role.startswith("fan_speed"):
            rows.append(table.values[j] ** 3)
        elif role.startswith("fan_speed") and table.series[j].tag.role == "fan_power":
            rows.append(np.cbrt(table.values[j]))
    known = np.isfinite(table.values[k]).sum()
    if not rows or known < 2 * (len(rows) + 1):
        return np.ones((len(table.grid_s), 1))
    return design_matrix(np.stack(rows))


def _best_span(
    table: TagPanel, k: int, name: str, unit: Unit, edges: list[Edge], witnesses: _Witnesses
) -> _Span | None:
    """Return the most probable span of a tag in a unit, or None."""
    grid, x, own = table.grid_s, table.values[k], unit_of(table.series[k].tag.unit)
    other = np.asarray(unit.scale * (x - own.offset) / own.scale + unit.offset)
    time_s = table.series[k].time_s
    starts = [(float(time_s[0]), 0.0), *((e.after_s, e.odds) for e in edges if e.into)]
    ends = [(float(time_s[-1]), 0.0), *((e.before_s, e.odds) for e in edges if not e.into)]
    pairs = [
        (low, high, a + b)
        for (low, a), (high, b) in itertools.product(starts, ends)
        if high - low >= LEAST_S and (low > time_s[0] or high < time_s[-1])
    ]
    if not pairs:
        return None
    rows = np.array([[np.searchsorted(grid, low), np.searchsorted(grid, high, side="right")] for low, high, _ in pairs])
    edge_odds = np.array([odds for _, _, odds in pairs])
    predict, plain = witnesses.predict, witnesses.plain
    predictions = {(0, 0): plain}

    def of_rows(first: int, last: int) -> tuple[Array, float]:
        if (first, last) not in predictions:
            predictions[first, last] = predict(np.where(rows_inside(len(x), (first, last)), other, x))
        return predictions[first, last]

    spans = [(int(first), int(last)) for first, last in rows]
    tried: set[int] = set()
    for span in [(0, 0), *(spans[at] for at in np.argsort(-edge_odds, kind="stable")[:STARTS])]:
        for _ in range(ROUNDS):
            predicted, sigma = of_rows(*span)
            gain = 0.5 * (((x - predicted) / sigma) ** 2 - ((other - predicted) / sigma) ** 2)
            total = np.concatenate([[0.0], np.cumsum(np.clip(np.nan_to_num(gain), -CAP, CAP))])
            at = int(np.argmax(total[rows[:, 1]] - total[rows[:, 0]] + edge_odds))
            if spans[at] == span:
                break
            span = spans[at]
        tried.add(at)
    valid = []
    for at in sorted(tried):
        low, high, odds_of = pairs[at]
        if odds_of < SURE_EDGES and table.series[k].tag.role in UNWITNESSED:
            continue
        inside, predicted = rows_inside(len(x), spans[at]), of_rows(*spans[at])[0]
        odds_of_rows = evidence_of_rows(
            x, other, (plain[0], predicted), inside, unit.scale / own.scale, odds_of >= SURE_EDGES
        )
        total_odds = odds_of + odds_of_rows - float(np.log(len(pairs)))
        if total_odds >= LEAST_ODDS:
            valid.append((total_odds, low, high))
    if not valid:
        return None
    most, low, high = max(valid)
    by_factor = own.offset == unit.offset == 0.0
    inside = (grid >= low) & (grid <= high)
    if by_factor and not is_of_the_unit(x, other, inside, predict.matrix):
        return None
    return _Span(unit, name, low, high, most)
