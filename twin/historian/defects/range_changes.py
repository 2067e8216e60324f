"""Tags that read on another scale from one sample to the next: a transmitter that was given another range.

Such a jump has no factor of a unit. It is told from a step of the plant by three kinds of evidence, which must agree:

* the tag leaps between two samples, and the other tags show nothing unusual within an hour (a step of the plant moves
  its redundant measurements, a command or a state);
* over days, one map (times a factor, or plus a constant) makes the readings after the leap go with the prediction by
  the other tags, and as they stand they do not;
* the prediction without the leap, in which the other tags may explain it, is worse by a large share of it.

Plants start and stop at any hour. So the first is not needed where the other two are decisive: by one map the readings
of days go several times better with the tags that moved, too. Nor is it where no sample shows the leap, since the tag
was at rest or silent: the last reading at work before and the first one after are then its sides.

A leap by the factor between two units is a change of unit, whatever hid it from the search for these.

Sizes that the plant's own faults have are no change of range: the bias of a thermometer, the pitch of a fan's blades.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.historian.checks import FAN_APART, THERMOMETER_K
from twin.historian.defects.panel import RobustPredictor, TagPanel, design_matrix, on_grid, panel
from twin.historian.defects.unit_switch import Switch, other_units
from twin.historian.tags import Array, Defect, Mask, Series, longest_interval_s
from twin.historian.units import unit_of

WITNESSED = frozenset(
    {
        "water_inlet_temperature",
        "water_outlet_temperature",
        "basin_temperature",
        "return_header_temperature",
        "supply_temperature",
        "water_flow",
        "header_pressure",
        "pump_power",
        "station_heat_load",
        "dry_bulb_temperature",
        "wet_bulb_temperature",
        "relative_humidity",
        "relative_humidity_redundant",
        "barometric_pressure",
    }
)
"""Roles that other tags follow. A valve, a command or the makeup is set by hand or switched, and may leap alone."""
WEATHER = frozenset(
    {
        "dry_bulb_temperature",
        "wet_bulb_temperature",
        "relative_humidity",
        "relative_humidity_redundant",
        "barometric_pressure",
    }
)
FANS = ("fan_speed", "fan_power")
LEAST = {"temperature": 1.5 * THERMOMETER_K, "share": 10.0}
"""Smallest leap by dimension, in the record's unit: beyond the largest bias that a calibration may find; of a humidity,
five times the tolerance of its measurement (2 %)."""
LEAST_SHARE = 0.15
"""Smallest leap of a flow, power or pressure as a share of the reading: flow meters drift by a third of it."""
LEAST_KPA = 2.0
"""Smallest leap of a barometer, ten times what the weather does in an hour."""
SMALLEST_WORK = 0.1
"""Share of the 95 % quantile of a flow, power or pressure below which it is at rest."""
LEVEL = 3
"""Samples on either side of a leap whose median is the level."""
HOUR_S = 3600.0
HELD = 0.6
"""Share of the leap between two samples by which the levels must differ."""
FAR = 4.0
"""Standard deviations of a tag's usual steps beyond which it leaps; they grow with the root of the time between
samples."""
UNUSUAL = 6.0
"""Usual changes of a tag within the hour about a leap, from which it moved as well. A plant's changes have heavy
tails."""
USUAL = 0.9, 1.645
"""Quantile of the changes by which their standard deviation is known, and that of a normal distribution."""
AFTER_S = 5.0 * 86400.0, 43200.0
"""Times after a leap over which it must last; the second is for a range that is soon corrected."""
BEFORE_S = 5.0 * 86400.0
SURER = 2.0
"""Ratio of the doubts of two maps from which the shorter time's is taken."""
LAW_S, LAW_APART = 43200.0, 0.3
"""Time on either side of a leap over which the law of a fan gives its factor: short, since other leaps may be near; and
by how much it may differ from that of the other tags, in logarithms."""
LEAST_ROWS = 16
"""Rows of a quarter of an hour on either side by which a leap is judged: four hours of operation."""
HIDDEN_ROWS = 96
"""The same of a leap that no sample shows, a day: as many as tags that predict explain any few rows."""
CLEAR = 0.35
"""Largest median distance of the mapped readings from their prediction, as a share of the leap."""
CLEARLY = 1.25
"""Distance from the prediction, as a multiple of that of the other map, up to which a flow, power or pressure is taken
to keep its zero, and a temperature its span."""
EXPLAINS = 0.3
"""Share of the leap by which the shorter side is worse predicted without it."""
DECISIVE = 4.0
"""Times by which the mapped readings of one side are nearer to their prediction than the readings as they stand, so
that the other tags need not rest: a step of the plant is in those tags, and its mapped readings are not nearer."""
ALIKE = 1e-6
"""Ridge of those sums of squares, as a share of the rows: far below what a tag tells."""
STEP_EXPLAINS = 1.5
"""Ratio of the sums of squares without and with a step, from which a leap beside others is judged at all."""
EDGE = 0.5
"""Share of a step between samples by which the map of days may differ from it."""
OF_A_UNIT = 0.04
"""Difference of a factor's logarithm from that between two units, up to which it is a unit's: what the laws of fans and
pumps leave open over days."""
BACK = 0.35
"""Share of a leap, at the usual reading, by which the return from it may differ."""
ROUNDS = 4
FEWEST = 100
"""Samples of a tag below which nothing is judged by them."""
MOST, MOST_HIDDEN = 100, 40
"""Leaps of a tag that are judged, the largest first, those that the samples show and those that they do not; the first
is also the most changes of range of a station."""


@dataclass(frozen=True)
class _Leap:
    """A leap of a tag: times of the readings before and after it, and the map from the old reading to the new one."""

    before_s: float
    after_s: float
    factor: float
    constant: float
    doubt: float
    """Distance of the mapped readings from their prediction, as a share of the leap."""
    hidden: bool
    """No sample shows it."""


@dataclass(frozen=True)
class RangeChanges:
    """Spans in which tags read on another scale: of the kind `range_change`, and those whose scale is of a unit."""

    ranges: tuple[Defect, ...]
    units: tuple[Switch, ...]

    @property
    def defects(self) -> list[Defect]:
        """Both."""
        return [*self.ranges, *(one.defect for one in self.units)]


def range_changes(
    series: Sequence[Series], roles: frozenset[str] = WITNESSED | {*FANS}, full_speed: str = "60 Hz"
) -> RangeChanges:
    """Return the spans in which tags read on another scale than before.

    The readings before the first leap of a tag are taken as right.

    Parameters
    ----------
    series
        Good samples of the tags in the units of the dictionary, without changes of unit and stuck values.
    roles
        Of the tags that are judged; all of them are witnesses.
    full_speed
        Speed of a fan at 100 %, with its unit: a share and a frequency are units of one quantity.
    """
    table = panel(series)
    leaps: dict[int, list[_Leap]] = {k: [] for k, one in enumerate(table.series) if one.tag.role in roles}
    judged: dict[int, list[_Leap]] = {}
    anew = [k for k in leaps if _candidates(table, k)]
    for _ in range(MOST):
        unusual = _unusual(table)
        judged |= {k: _borne_out(table, k, leaps[k], unusual) for k in anew}
        surest = min(
            ((leap.hidden, leap.doubt, k, leap) for k, found in judged.items() for leap in found),
            key=lambda one: one[:3],
            default=None,
        )
        if surest is None:
            break
        # Leaps that the samples show, and of them the surest, come first: with its readings mapped, the leaps of the
        # tags that they predict are judged anew.
        _, _, k, leap = surest
        leaps[k].append(leap)
        table = _mapped(table, k, leap)
        anew = [j for j in judged if _related(table, k, j)]
    spans = [(table.series[k], one) for k, found in leaps.items() for one in _spans(table.series[k], found)]
    units = {id(span): _unit_of(one, span, full_speed) for one, span in spans}
    return RangeChanges(
        tuple(_defect(one, span) for one, span in spans if units[id(span)] is None),
        tuple(switch for switch in units.values() if switch is not None),
    )


def _borne_out(table: TagPanel, k: int, before: Sequence[_Leap], unusual: Array) -> list[_Leap]:
    """Return the leaps of a tag that the other tags bear out, beside those that were found before."""
    found = []
    candidates = _candidates(table, k)
    if not candidates:
        return []
    rest = SMALLEST_WORK * float(np.nanquantile(np.abs(table.values[k]), 0.95)) if _is_ratio(table.series[k]) else None
    ratio = _law_ratio(table, k) if table.series[k].tag.role in FANS else np.zeros(0)
    for at in candidates:
        if any(leap.before_s == table.series[k].time_s[at.row] for leap in before):
            continue
        if len(ratio) and not _splits_best(table.series[k], ratio, at, candidates):
            continue
        back = _return(table, k, at, before)
        alone = not at.hidden and not _others_moved(table, k, float(table.series[k].time_s[at.after]), unusual)
        leap = _judged(table, k, at, back, rest, alone=alone or back is not None)
        if leap is not None:
            found.append(leap)
    return found


def _splits_best(series: Series, ratio: Array, at: _Candidate, candidates: Sequence[_Candidate]) -> bool:
    """Return whether of the candidates nearby a leap of a fan's tag is the one about which its ratio to the law is two
    levels, by least absolute error."""
    time_s = series.time_s
    low, high = np.searchsorted(time_s, (time_s[at.row] - LAW_S, time_s[at.after] + LAW_S)).tolist()

    def error(one: _Candidate) -> float:
        sides = ratio[low : one.row + 1], ratio[one.after : high]
        return sum(float(np.nansum(np.abs(side - np.nanmedian(side)))) for side in sides)

    near = [one for one in candidates if low <= one.row and one.after < high]
    return error(at) <= min((error(one) for one in near), default=np.inf)


def _mapped(table: TagPanel, k: int, leap: _Leap) -> TagPanel:
    """Return the table with a tag's readings after a leap mapped to those before it."""
    one = table.series[k]
    unit = unit_of(one.tag.unit)
    again = ((unit.scale * one.value + unit.offset - leap.constant) / leap.factor - unit.offset) / unit.scale
    mapped = replace(
        one,
        value=np.where(one.time_s >= leap.after_s, again, one.value),
        holes=np.concatenate([one.holes, [[leap.after_s, leap.after_s]]]),
    )
    values = table.values.copy()
    values[k] = on_grid(mapped, table.grid_s)
    return TagPanel((*table.series[:k], mapped, *table.series[k + 1 :]), table.grid_s, values)


def _related(table: TagPanel, k: int, j: int) -> bool:
    """Return whether two tags are of one cell, or one of them of the station."""
    cells = table.series[k].tag.cell, table.series[j].tag.cell
    return None in cells or cells[0] == cells[1]


def _canonical(series: Series) -> Array:
    unit = unit_of(series.tag.unit)
    return np.asarray(unit.scale * series.value + unit.offset)


def _is_ratio(series: Series) -> bool:
    """Return True for a quantity whose changes count as shares of it."""
    return unit_of(series.tag.unit).dimension not in LEAST and series.tag.role != "barometric_pressure"


@dataclass(frozen=True)
class _Candidate:
    """Rows of the last reading of a tag before a leap and of the first one after it; `hidden` where the tag was at rest
    or silent in between, so that its samples do not show the leap."""

    row: int
    after: int
    hidden: bool

    def sides(self, x: Array) -> tuple[float, float]:
        """Return the levels of values (n,) on either side."""
        return (
            float(np.nanmedian(x[max(self.row + 1 - LEVEL, 0) : self.row + 1])),
            float(np.nanmedian(x[self.after : self.after + LEVEL])),
        )


def _candidates(table: TagPanel, k: int) -> list[_Candidate]:
    """Return where a tag leaps to another level, the largest leap first."""
    series = table.series[k]
    if not _witnessed(table, k) or len(series.time_s) < FEWEST:
        return []
    x, least = _canonical(series), LEAST.get(unit_of(series.tag.unit).dimension, LEAST_KPA)
    if series.tag.role in FANS:
        x, least = _law_ratio(table, k), _least_ratio(series)
    elif _is_ratio(series):
        rest = max(SMALLEST_WORK * float(np.quantile(np.abs(x), 0.95)), 1e-9)
        x, least = np.where(x > rest, np.log(np.maximum(x, rest)), np.nan), _least_ratio(series)
    work = np.flatnonzero(np.isfinite(x))
    if len(work) < FEWEST:
        return []
    ends = np.concatenate([[0], np.cumsum(series.broken())])
    hidden = (np.diff(work) > 1) | (ends[work[1:]] > ends[work[:-1]])
    step = np.diff(x[work])
    apart = np.diff(series.time_s[work])
    usual = float(np.quantile(np.abs(step[~hidden]), USUAL[0])) / USUAL[1] if (~hidden).any() else 0.0
    stretch = np.sqrt(np.maximum(apart / max(float(np.median(apart)), 1e-9), 1.0))
    far = np.maximum(least, 0.0 if series.tag.role in FANS else FAR * usual * stretch)
    found: list[tuple[float, _Candidate]] = []
    for i in np.flatnonzero(hidden | (np.abs(step) >= far)).tolist():
        at = _Candidate(int(work[i]), int(work[i + 1]), bool(hidden[i]))
        before, after = at.sides(x)
        if hidden[i] and abs(after - before) >= least:
            found.append((-abs(after - before), at))
        elif not hidden[i] and (after - before) * np.sign(step[i]) >= HELD * abs(step[i]):
            # On the two levels that the step joins: no spike, and no ramp.
            found.append((-abs(float(step[i])), at))
    found.sort(key=lambda one: (one[0], one[1].row))
    seen = [at for _, at in found if not at.hidden][:MOST]
    return seen + [at for _, at in found if at.hidden][:MOST_HIDDEN]


def _of_its_fan(table: TagPanel, k: int) -> Array:
    """Return the logarithm of the law by which another tag of the same fan follows, at the samples of a tag (n,).

    Power goes with the cube of the speed, and the speed with its command.
    """
    own = table.series[k]
    of_fan = {one.tag.role: one for one in table.series if one.tag.cell == own.tag.cell}
    laws = (("fan_speed", 3.0), ("fan_speed_command", 3.0)) if own.tag.role == "fan_power" else _SPEED_LAWS
    other, power = next((of_fan[role], power) for role, power in laws if role in of_fan)
    limit = 1.2 * longest_interval_s(other)
    value = unit_of(other.tag.unit).scale * other.at(own.time_s, limit)
    rest = SMALLEST_WORK * float(np.quantile(np.abs(_canonical(other)), 0.95))
    return np.asarray(power * np.where(value > rest, np.log(np.maximum(value, max(rest, 1e-9))), np.nan))


_SPEED_LAWS = (("fan_speed_command", 1.0), ("fan_power", 1.0 / 3.0))


def _witnessed(table: TagPanel, k: int) -> bool:
    """Return whether other tags follow a tag; a fan's speed and power only beside another tag of the same fan."""
    tag = table.series[k].tag
    if tag.role not in FANS:
        return tag.role in WITNESSED
    of_fan = {one.tag.role for one in table.series if one.tag.cell == tag.cell}
    return len(of_fan & {*FANS, "fan_speed_command"}) > 1


def _unusual(table: TagPanel) -> Array:
    """Return the changes of each tag over the hour about each row, in usual ones (tags, m); NaN where unknown."""
    rows = round(HOUR_S / (table.grid_s[1] - table.grid_s[0])) if len(table.grid_s) > 1 else 1
    change = np.full_like(table.values, np.nan)
    if table.values.shape[1] > 2 * rows:
        change[:, rows:-rows] = np.abs(table.values[:, 2 * rows :] - table.values[:, : -2 * rows])
    found = np.full_like(change, np.nan)
    for k, one in enumerate(table.series):
        if (
            unit_of(one.tag.unit).dimension == "angle"
            or one.tag.role == "wind_speed"
            or not np.isfinite(change[k]).any()
        ):
            continue
        usual = float(np.nanquantile(change[k], USUAL[0])) / USUAL[1]
        if unit_of(one.tag.unit).dimension == "state":
            found[k] = np.where(change[k] > 0.0, np.inf, 0.0)
        else:
            found[k] = change[k] / max(usual, 1e-9)
    return found


def _others_moved(table: TagPanel, k: int, at_s: float, unusual: Array) -> bool:
    """Return whether another tag of the cell or the station moved unusually within the hour about a time.

    The weather does not follow the plant, so only its own instruments count for it.
    """
    row = int(np.clip(np.searchsorted(table.grid_s, at_s), 0, len(table.grid_s) - 1))
    moved = np.nanmax(np.nan_to_num(unusual[:, max(row - 1, 0) : row + 2], posinf=np.inf), axis=1) > UNUSUAL
    weather = table.series[k].tag.role in WEATHER
    counts = [
        j != k and _related(table, k, j) and (not weather or one.tag.role in WEATHER)
        for j, one in enumerate(table.series)
    ]
    return bool((moved & np.array(counts)).any())


def _return(table: TagPanel, k: int, at: _Candidate, leaps: Sequence[_Leap]) -> tuple[float, float] | None:
    """Return factor and constant of a leap that goes back by what the leaps of the tag before it have left, so that it
    ends their span; None for another leap."""
    x, at_s = _canonical(table.series[k]), float(table.series[k].time_s[at.row])
    factor, constant = 1.0, 0.0
    for leap in (one for one in leaps if one.after_s <= at_s):
        factor, constant = factor * leap.factor, constant * leap.factor + leap.constant
    if np.isclose(factor, 1.0) and np.isclose(constant, 0.0, atol=1e-6):
        return None
    inverse = 1.0 / factor, -constant / factor
    # The table holds the readings mapped already: a return leaves them short by the same map.
    before, after = at.sides(x)
    if constant == 0.0:
        wanted, seen = -float(np.log(factor)), float(np.log(after / before)) if min(before, after) > 0.0 else np.inf
    else:
        wanted, seen = inverse[0] * before + inverse[1] - before, after - before
    return inverse if abs(seen - wanted) < BACK * abs(wanted) else None


def _witnesses(table: TagPanel, k: int, rows: slice) -> Array:
    """Return what predicts a tag over some rows: the other tags, and the laws that tie them."""
    tag = table.series[k].tag
    drivers = [
        j
        for j, one in enumerate(table.series)
        if j != k and unit_of(one.tag.unit).dimension != "angle" and _related(table, k, j)
    ]
    values = [table.values[j, rows] for j in drivers]
    for j in drivers:
        role = table.series[j].tag.role
        if tag.role == "fan_power" and role.startswith("fan_speed"):
            values.append(table.values[j, rows] ** 3)
        elif tag.role == "fan_speed" and role == "fan_power":
            values.append(np.cbrt(table.values[j, rows]))
    return design_matrix(np.stack(values)) if values else np.ones((rows.stop - rows.start, 1))


def _judged(
    table: TagPanel, k: int, at: _Candidate, back: tuple[float, float] | None, rest: float | None, *, alone: bool
) -> _Leap | None:
    """Return a leap of a tag with its map, or None if the other tags do not bear it out.

    The longest time over which it may last tells its map best, unless a shorter one leaves much less doubt: the longer
    one may hold its return.

    Parameters
    ----------
    back
        Map of a return, which is tried before any other.
    rest
        Reading up to which the tag is at rest, in the record's unit; None for a tag that has no rest.
    alone
        No other tag moved then. Else the evidence must be decisive.
    """
    found = [
        one for last_s in AFTER_S if (one := _judged_over(table, k, at, back, rest, last_s, alone=alone)) is not None
    ]
    least = min((one.doubt for one in found), default=0.0)
    return next((one for one in found if one.doubt <= SURER * least), None)


def _judged_over(
    table: TagPanel,
    k: int,
    at: _Candidate,
    back: tuple[float, float] | None,
    rest: float | None,
    last_s: float,
    *,
    alone: bool,
) -> _Leap | None:
    """Return a leap with its map by the readings up to `last_s` after it, or None."""
    series, grid = table.series[k], table.grid_s
    before_s, after_s = float(series.time_s[at.row]), float(series.time_s[at.after])
    low, high = np.searchsorted(grid, (before_s - BEFORE_S, after_s + last_s)).tolist()
    rows = slice(low, high)
    x = table.values[k, rows]
    if rest is not None:
        x = np.where(np.abs(x) > rest, x, np.nan)
    x = np.where((grid[rows] > before_s) & (grid[rows] < after_s), np.nan, x)
    after = grid[rows] >= after_s
    if _fewest(x, after) < (HIDDEN_ROWS if at.hidden else LEAST_ROWS):
        return None
    matrix = _witnesses(table, k, rows)
    if not alone and not _step_explains(x, after, matrix):
        return None
    predict = RobustPredictor(matrix)
    plain, _ = predict(x)
    returned = None if back is None else _with_map(x, after, predict, *back)
    if back is not None and returned is not None and returned.is_borne_out(x - plain, after, alone=True):
        return _Leap(before_s, after_s, *back, returned.doubt(after), at.hidden)
    if np.nansum(np.abs(x - plain)) <= EXPLAINS * _least_leap(series, at, x[after]) * _fewest(x, after):
        return None  # whatever the map: no prediction is nearer than the readings themselves
    usual_map = _is_ratio(series) or series.tag.role in FANS
    by_law = _by_law(table, k, at)
    fits = [_fitted(x, after, predict, ratio=ratio, first=by_law) for ratio in (usual_map, not usual_map)]
    errors = [np.inf if one is None else one.error for one in fits]
    fit = fits[0] if errors[0] <= CLEARLY * errors[1] else fits[1]
    if fit is None or not fit.is_borne_out(x - plain, after, alone=alone):
        return None
    if not _large(series, at, fit) or not (at.hidden or _at_the_edge(series, at, fit)):
        return None
    as_the_law = by_law is not None and fit.constant == 0.0 and abs(float(np.log(by_law / fit.factor))) < LAW_APART
    if at.hidden and by_law is not None and not as_the_law:
        return None
    factor = by_law if by_law is not None and as_the_law else fit.factor
    return _Leap(before_s, after_s, factor, fit.constant, fit.doubt(after), at.hidden)


def _step_explains(x: Array, after: Mask, matrix: Array) -> bool:
    """Return whether a step leaves much less of a tag than the other tags alone do, by least squares."""
    rows = np.isfinite(x)
    columns = np.column_stack([matrix[rows], after[rows].astype(np.float64)])
    y = x[rows] - x[rows].mean()
    gram, right = columns.T @ columns, columns.T @ y
    # Tags that are alike would make the equations singular.
    gram[np.diag_indices_from(gram)] += ALIKE * len(y)
    left = []
    for count in (matrix.shape[1], matrix.shape[1] + 1):
        found = np.linalg.solve(gram[:count, :count], right[:count])
        left.append(float(((y - columns[:, :count] @ found) ** 2).sum()))
    return left[0] > STEP_EXPLAINS * left[1]


def _by_law(table: TagPanel, k: int, at: _Candidate) -> float | None:
    """Return the factor of a fan's tag by the law of its fan, over the hours about a leap; None for another tag."""
    series = table.series[k]
    if series.tag.role not in FANS:
        return None
    ratio = _law_ratio(table, k)
    time_s = series.time_s
    low, high = np.searchsorted(time_s, (time_s[at.row] - LAW_S, time_s[at.after] + LAW_S)).tolist()
    change = float(np.nanmedian(ratio[at.after : high]) - np.nanmedian(ratio[low : at.row + 1]))
    return float(np.exp(change)) if np.isfinite(change) else None


def _law_ratio(table: TagPanel, k: int) -> Array:
    """Return the logarithm of the readings of a fan's tag over those of the law of its fan (n,); NaN at rest."""
    x = _canonical(table.series[k])
    rest = max(SMALLEST_WORK * float(np.quantile(np.abs(x), 0.95)), 1e-9)
    return np.asarray(np.where(x > rest, np.log(np.maximum(x, rest)), np.nan) - _of_its_fan(table, k))


def _at_the_edge(series: Series, at: _Candidate, fit: _Fit) -> bool:
    """Return whether the map of days is the step that the samples show at the leap.

    The two samples that it joins show it beside what the plant does meanwhile, the levels of some beside their noise.
    """
    x = _canonical(series)
    for before, after in (at.sides(x), (float(x[at.row]), float(x[at.after]))):
        if abs(fit.factor * before + fit.constant - after) <= EDGE * abs(after - before):
            return True
    return False


def _large(series: Series, at: _Candidate, fit: _Fit) -> bool:
    """Return whether the map of days changes the reading at the leap by more than the plant's own faults do."""
    before, _ = at.sides(_canonical(series))
    mapped = fit.factor * before + fit.constant
    if not _is_ratio(series):
        return abs(mapped - before) >= LEAST.get(unit_of(series.tag.unit).dimension, LEAST_KPA)
    return abs(float(np.log(max(mapped, 1e-9) / max(before, 1e-9)))) >= _least_ratio(series)


def _least_leap(series: Series, at: _Candidate, after: Array) -> float:
    """Return the smallest median leap of the readings `after` (n,) by a map that is large and, of a leap that the
    samples show, at its edge."""
    x = _canonical(series)
    levels = at.sides(x)
    if _is_ratio(series):
        # Of a rise and a fall by one ratio the fall is the smaller change.
        least = abs(levels[0]) * -float(np.expm1(-_least_ratio(series)))
    else:
        least = LEAST.get(unit_of(series.tag.unit).dimension, LEAST_KPA)
    shares = [least / max(abs(levels[0]), 1e-9)]
    if not at.hidden:
        pairs = levels, (float(x[at.row]), float(x[at.after]))
        least = max(least, (1.0 - EDGE) * min(abs(end - start) for start, end in pairs))
        shares.append((1.0 - EDGE) * min(abs(end - start) / max(abs(start), 1e-9) for start, end in pairs))
    share = max(shares)
    return min(least, share / (1.0 + share) * float(np.nanmedian(np.abs(after))))


def _fewest(x: Array, after: Mask) -> int:
    """Return the known readings (m,) of the side of a leap that has fewer."""
    known = np.isfinite(x)
    return int(min((known & after).sum(), (known & ~after).sum()))


def _least_ratio(series: Series) -> float:
    return float(np.log1p(FAN_APART if series.tag.role == "fan_power" else LEAST_SHARE))


@dataclass(frozen=True)
class _Fit:
    """Map of the readings after a leap, their leap (m,) and the distance of the mapped readings from the prediction."""

    factor: float
    constant: float
    leap: Array
    residual: Array

    @property
    def error(self) -> float:
        """Median distance from the prediction; infinite where there is none."""
        if not np.isfinite(self.residual).any():
            return float(np.inf)
        return float(np.nanmedian(np.abs(self.residual)))

    def doubt(self, after: Mask) -> float:
        """Return the distance of the mapped readings from the prediction as a share of the leap."""
        return self.error / float(np.nanmedian(np.abs(self.leap[after])))

    def is_borne_out(self, plain: Array, after: Mask, *, alone: bool) -> bool:
        """Return whether the other tags go with the mapped readings on both sides, and cannot explain them unmapped.

        Parameters
        ----------
        plain
            Distance of the readings as they stand from a prediction without the leap (m,).
        after
            Rows after the leap (m,).
        alone
            No other tag moved then. Else the mapped readings must be `DECISIVE` times as near to their prediction.
        """
        known = np.isfinite(self.residual) & np.isfinite(plain)
        parts = [known & after, known & ~after]
        size = float(np.median(np.abs(self.leap[parts[0]]))) if parts[0].any() else 0.0
        if size <= 0.0:
            return False
        if any(float(np.median(np.abs(self.residual[part]))) > CLEAR * size for part in parts):
            return False
        nearer = (np.abs(plain[part]).mean() / max(np.abs(self.residual[part]).mean(), 1e-9) for part in parts)
        if not alone and max(nearer) < DECISIVE:
            return False
        gained = float(np.abs(plain[known]).sum() - np.abs(self.residual[known]).sum())
        return gained > EXPLAINS * size * float(min(part.sum() for part in parts))


def _fitted(x: Array, after: Mask, predict: RobustPredictor, *, ratio: bool, first: float | None = None) -> _Fit | None:
    """Return the map by a factor (or else a constant) with which the readings after a leap go with the prediction.

    `first` is the factor to begin with; None for that of the hours about the leap.
    """
    sides = [np.flatnonzero(np.isfinite(x) & part) for part in (~after, after)]
    near = [float(np.median(x[part])) for part in (sides[0][-LEAST_ROWS // 4 :], sides[1][: LEAST_ROWS // 4])]
    if ratio and not (near[0] > 0.0 and near[1] > 0.0):
        return None
    factor, constant = (first or near[1] / near[0], 0.0) if ratio else (1.0, near[1] - near[0])
    for _ in range(ROUNDS):
        mapped = np.where(after, (x - constant) / factor, x)
        predicted, _ = predict(mapped)
        there = predicted[sides[1]]
        if ratio:
            factor = float(np.median(x[sides[1]] / np.where(there > 0.0, there, np.nan)))
            if not factor > 0.0:
                return None
        else:
            constant = float(np.median(x[sides[1]] - there))
    return _with_map(x, after, predict, factor, constant)


def _with_map(x: Array, after: Mask, predict: RobustPredictor, factor: float, constant: float) -> _Fit:
    """Return how the readings go with the prediction if those after a leap are mapped back by this map."""
    mapped = np.where(after, (x - constant) / factor, x)
    predicted, _ = predict(mapped)
    return _Fit(factor, constant, np.where(after, x - mapped, 0.0), mapped - predicted)


@dataclass(frozen=True)
class _OtherScale:
    """A span of a tag on another scale: times, and the map from its readings before."""

    start_s: float
    end_s: float
    factor: float
    constant: float


def _spans(series: Series, leaps: Sequence[_Leap]) -> list[_OtherScale]:
    """Return the spans between leaps in which the readings are on another scale than before the first."""
    found: list[_OtherScale] = []
    factor, constant, since = 1.0, 0.0, 0.0
    in_order = sorted(leaps, key=lambda one: one.after_s)
    usual = float(np.median(_canonical(series)[series.time_s < in_order[0].after_s])) if in_order else 0.0
    for leap in in_order:
        if (factor, constant) != (1.0, 0.0):
            found.append(_OtherScale(since, leap.before_s, factor, constant))
        total = factor * leap.factor, constant * leap.factor + leap.constant
        off, left = ((f - 1.0) * usual + c for f, c in ((factor, constant), total))
        back = off != 0.0 and abs(left) < BACK * abs(off)
        factor, constant = (1.0, 0.0) if back else total
        since = leap.after_s
    if (factor, constant) != (1.0, 0.0) and len(series.time_s):
        found.append(_OtherScale(since, float(series.time_s[-1]), factor, constant))
    return found


def _unit_of(series: Series, span: _OtherScale, full_speed: str) -> Switch | None:
    """Return a span as a change of unit if its factor is that between two units, of some the nearest."""
    own = unit_of(series.tag.unit)
    if span.constant != 0.0 or own.offset != 0.0:
        return None
    near = [
        (abs(float(np.log(span.factor * unit.scale / own.scale))), name, unit)
        for name, unit in other_units(series, full_speed).items()
        if unit.offset == 0.0
    ]
    # Of units that are alike, as L/s and kg/s, the first is of the tag's own kind.
    apart, name, unit = min(near, key=lambda one: round(one[0], 2), default=(np.inf, "", own))
    if apart > OF_A_UNIT:
        return None
    says = f"{series.tag.name} is in {name} instead of {series.tag.unit}"
    return Switch(Defect("unit_switch", (series.tag.name,), span.start_s, span.end_s, says, "converted"), unit)


def _defect(series: Series, span: _OtherScale) -> Defect:
    unit = unit_of(series.tag.unit)
    # The map is of the record's unit; the store is corrected in the tag's own, whose zero may be another.
    own = (span.constant + (span.factor - 1.0) * unit.offset) / unit.scale
    times = f"{span.factor:.3g} times what it did" if span.factor != 1.0 else ""
    more = f"{abs(own):.3g} {series.tag.unit} {'more' if own > 0.0 else 'less'}" if own != 0.0 else ""
    says = f"{series.tag.name} reads "
    says += f"{times} and {more}" if times and more else times or f"{more} than it did"
    says += ", and no other tag shows it: its range was changed; correct the readings in the store"
    return Defect("range_change", (series.tag.name,), span.start_s, span.end_s, says, "left out")
