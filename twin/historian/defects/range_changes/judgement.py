"""Judgement of a leap by the other tags: they rest, go with the mapped readings, and do not explain the leap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.historian.defects.panel import (
    BASIN,
    SMALLEST_WORK,
    RobustPredictor,
    TagPanel,
    basin_inflows,
    design_matrix,
    known_median,
    stands,
)
from twin.historian.defects.range_changes.candidates import LAW_APART, LAW_S, USUAL, LeapCandidate
from twin.historian.defects.range_changes.maps import (
    BACK,
    CLEAR,
    EXPLAINS,
    LEAST_ROWS,
    Leap,
    ScaleFit,
    fit_with_map,
    fitted_map,
)
from twin.historian.defects.range_changes.readings import (
    FANS,
    LEAST,
    LEAST_KPA,
    WEATHER,
    canonical,
    is_ratio,
    law_ratio,
    least_ratio,
    power_ratio,
    related,
)
from twin.historian.tags import Array, Mask, Series
from twin.historian.units import unit_of

HOUR_S = 3600.0
UNUSUAL = 6.0
"""Usual changes of a tag within the hour about a leap, from which it moved as well. A plant's changes have heavy
tails."""
AFTER_S = 5.0 * 86400.0, 43200.0
"""Times after a leap over which it must last; the second is for a range that is soon corrected."""
BEFORE_S = 5.0 * 86400.0
SURER = 2.0
"""Ratio of the doubts of two maps from which the shorter time's is taken."""
HIDDEN_ROWS = 96
"""The same of a leap that no sample shows, a day: as many as tags that predict explain any few rows."""
CLEARLY = 1.25
"""Distance from the prediction, as a multiple of that of the other map, up to which a flow, power or pressure is taken
to keep its zero, and a temperature its span."""
ALIKE = 1e-6
"""Ridge of those sums of squares, as a share of the rows: far below what a tag tells."""
STEP_EXPLAINS = 1.5
"""Ratio of the sums of squares without and with a step, from which a leap beside others is judged at all."""
EDGE = 0.5
"""Share of a step between samples by which the map of days may differ from it."""


def unusual_changes(table: TagPanel) -> Array:
    """Return the changes of each tag over the hour about each row, in usual ones (tags, m); NaN where unknown.

    That of a state, or of what starts or stops to work within the hour, has no bound.
    """
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
            found[k] = np.where(_changes_within(table.values[k], rows), np.inf, 0.0)
        else:
            found[k] = change[k] / max(usual, 1e-9)
            if is_ratio(one):
                rest = SMALLEST_WORK * float(np.nanquantile(np.abs(table.values[k]), 0.95))
                works = np.where(np.isfinite(table.values[k]), np.abs(table.values[k]) > rest, np.nan)
                found[k][_changes_within(works, rows)] = np.inf
    return found


def _changes_within(state: Array, rows: int) -> Mask:
    """Return where a state (m,), NaN where unknown, changes within some rows before or after, also for a moment."""
    known = np.flatnonzero(np.isfinite(state))
    leaps = np.zeros(len(state))
    changed = np.flatnonzero(np.diff(state[known]) != 0.0)
    leaps[known[changed]] = leaps[known[changed + 1]] = 1.0
    return np.asarray(np.convolve(leaps, np.ones(2 * rows + 1), mode="same") > 0.5)


def others_moved(table: TagPanel, k: int, at_s: float, unusual: Array) -> bool:
    """Return whether another tag of the cell or the station moved unusually within the hour about a time.

    The weather does not follow the plant, so only its own instruments count for it.
    """
    row = int(np.clip(np.searchsorted(table.grid_s, at_s), 0, len(table.grid_s) - 1))
    moved = np.nanmax(np.nan_to_num(unusual[:, max(row - 1, 0) : row + 2], posinf=np.inf), axis=1) > UNUSUAL
    weather = table.series[k].tag.role in WEATHER
    counts = [
        j != k and related(table, k, j) and (not weather or one.tag.role in WEATHER)
        for j, one in enumerate(table.series)
    ]
    return bool((moved & np.array(counts)).any())


def return_map(table: TagPanel, k: int, at: LeapCandidate, leaps: Sequence[Leap]) -> tuple[float, float] | None:
    """Return factor and constant of a leap that takes back others of its tag; None for another leap.

    It goes back by what the leaps before it have left, so that it ends their span, or by a later one, so that it begins
    the span which that one ends.
    """
    at_s = float(table.series[k].time_s[at.row])
    others = [total_map(leaps, at_s), *((one.factor, one.constant) for one in leaps if one.before_s > at_s)]
    by_law = _by_law(table, k, at)
    return next((back for one in others if (back := _taken_back(table.series[k], at, *one, by_law)) is not None), None)


def total_map(leaps: Sequence[Leap], at_s: float) -> tuple[float, float]:
    """Return factor and constant of all leaps of a tag before a time together."""
    factor, constant = 1.0, 0.0
    for leap in (one for one in leaps if one.after_s <= at_s):
        factor, constant = factor * leap.factor, constant * leap.factor + leap.constant
    return factor, constant


def _taken_back(
    series: Series, at: LeapCandidate, factor: float, constant: float, by_law: float | None
) -> tuple[float, float] | None:
    """Return the map that takes back another one, if a leap goes by about as much; else None.

    A fan turns at another speed on the other side of a rest, so that its law tells how far its readings go (`by_law`).
    """
    if np.isclose(factor, 1.0) and np.isclose(constant, 0.0, atol=1e-6):
        return None
    inverse = 1.0 / factor, -constant / factor
    # The table holds the readings mapped already: a return leaves them short by the same map.
    before, after = at.sides(canonical(series))
    if constant == 0.0 and by_law is not None:
        wanted, seen = -float(np.log(factor)), float(np.log(by_law))
    elif constant == 0.0:
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
        if j != k
        and unit_of(one.tag.unit).dimension != "angle"
        and (one.tag.cell in (None, tag.cell) or tag.cell is None)
    ]
    values = [table.values[j, rows] for j in drivers]
    if tag.role == BASIN:
        values += list(basin_inflows(table.between(rows), (k,)))
    for j in drivers:
        role = table.series[j].tag.role
        if tag.role == "fan_power" and role.startswith("fan_speed"):
            values.append(table.values[j, rows] ** 3)
        elif tag.role == "fan_speed" and role == "fan_power":
            values.append(np.cbrt(table.values[j, rows]))
    return design_matrix(np.stack(values)) if values else np.ones((rows.stop - rows.start, 1))


def judged_leap(
    table: TagPanel,
    k: int,
    at: LeapCandidate,
    before: Sequence[Leap],
    back: tuple[float, float] | None,
    rest: float | None,
    *,
    alone: bool,
) -> Leap | None:
    """Return a leap of a tag with its map, or None if the other tags do not bear it out.

    The longest time over which it may last tells its map best, unless a shorter one leaves much less doubt: the longer
    one may hold its return.

    Parameters
    ----------
    before
        Leaps of the tag that were found before. Readings that go with the other tags as well without their maps as with
        any other have come back, however far this leap goes: what a sensor read while it was off is no measure.
    back
        Map of a return, which is tried before any other.
    rest
        Reading up to which the tag is at rest, in the record's unit; None for a tag that has no rest.
    alone
        No other tag moved then. Else the evidence must be decisive.
    """
    factor, constant = total_map(before, float(table.series[k].time_s[at.row]))
    home = None if (factor, constant) == (1.0, 0.0) else (1.0 / factor, -constant / factor)
    found = [
        one
        for last_s in AFTER_S
        if (one := _judged_over(table, k, at, (back, home), rest, last_s, alone=alone)) is not None
    ]
    least = min((one.doubt for one in found), default=0.0)
    return next((one for one in found if one.doubt <= SURER * least), None)


def _judged_over(
    table: TagPanel,
    k: int,
    at: LeapCandidate,
    returns: tuple[tuple[float, float] | None, tuple[float, float] | None],
    rest: float | None,
    last_s: float,
    *,
    alone: bool,
) -> Leap | None:
    """Return a leap with its map by the readings up to `last_s` after it, or None.

    `returns` are maps of a return: one that goes as far as the leap, and that of all leaps before it.
    """
    (back, home), series, grid = returns, table.series[k], table.grid_s
    before_s, after_s = float(series.time_s[at.row]), float(series.time_s[at.after])
    low, high = np.searchsorted(grid, (before_s - BEFORE_S, after_s + last_s)).tolist()
    rows = slice(low, high)
    x = table.values[k, rows]
    if rest is not None:
        x = np.where(np.abs(x) > rest, x, np.nan)
    x = np.where(stands(series, table.series, grid[rows]), np.nan, x)
    x = np.where((grid[rows] > before_s) & (grid[rows] < after_s), np.nan, x)
    after = grid[rows] >= after_s
    by_law = _by_law(table, k, at)
    if at.hidden and back is not None and by_law is not None and _fewest(x, after) >= LEAST_ROWS:
        # The law of the fan has no weights that some rows could be explained by, and the map is known.
        apart = abs(float(np.log(by_law / back[0]))) / abs(float(np.log(back[0]))) if back[1] == 0.0 else np.inf
        if apart <= BACK:
            return Leap(before_s, after_s, *back, apart, at.hidden)
    outvoted = _outvoted(table, k, at, by_law) if at.hidden and _fewest(x, after) >= LEAST_ROWS else None
    if outvoted is not None:
        return outvoted
    if _fewest(x, after) < (HIDDEN_ROWS if at.hidden else LEAST_ROWS):
        return None
    matrix = _witnesses(table, k, rows)
    if not alone and not _step_explains(x, after, matrix):
        return None
    predict = RobustPredictor(matrix)
    plain, _ = predict(x)
    returned = None if back is None else fit_with_map(x, after, predict, *back)
    if back is not None and returned is not None and returned.is_borne_out(x - plain, after, alone=True):
        return Leap(before_s, after_s, *back, returned.doubt(after), at.hidden)
    if np.nansum(np.abs(x - plain)) <= EXPLAINS * _least_leap(series, at, x[after]) * _fewest(x, after):
        return None  # whatever the map: no prediction is nearer than the readings themselves
    usual_map = is_ratio(series) or series.tag.role in FANS
    fits = [fitted_map(x, after, predict, ratio=ratio, first=by_law) for ratio in (usual_map, not usual_map)]
    errors = [np.inf if one is None else one.error for one in fits]
    fit = fits[0] if errors[0] <= CLEARLY * errors[1] else fits[1]
    if fit is None or not fit.is_borne_out(x - plain, after, alone=alone):
        return None
    if not _large(series, at, fit) or not (at.hidden or _at_the_edge(series, at, fit)):
        return None
    if home is not None:
        there = fit_with_map(x, after, predict, *home)
        if there.error <= CLEARLY * fit.error and there.is_borne_out(x - plain, after, alone=True):
            return Leap(before_s, after_s, *home, there.doubt(after), at.hidden)
    as_the_law = by_law is not None and fit.constant == 0.0 and abs(float(np.log(by_law / fit.factor))) < LAW_APART
    if at.hidden and by_law is not None and not as_the_law:
        return None
    factor = by_law if by_law is not None and as_the_law else fit.factor
    return Leap(before_s, after_s, factor, fit.constant, fit.doubt(after), at.hidden)


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


def _by_law(table: TagPanel, k: int, at: LeapCandidate) -> float | None:
    """Return the factor of a fan's tag by the law of its fan, over the hours about a leap; None for another tag."""
    series = table.series[k]
    if series.tag.role not in FANS:
        return None
    change = _change(series, at, law_ratio(table, k))
    return float(np.exp(change)) if np.isfinite(change) else None


def _outvoted(table: TagPanel, k: int, at: LeapCandidate, by_law: float | None) -> Leap | None:
    """Return a leap of a fan's speed away from the law of its fan if power and command keep theirs; None otherwise.

    A drive at a limit, or under manual control, turns the fan otherwise than its command, but the power follows.
    """
    ratio, series = power_ratio(table, k), table.series[k]
    if ratio is None or by_law is None:
        return None
    size, kept = abs(float(np.log(by_law))), _change(series, at, ratio) / 3.0
    own = law_ratio(table, k)
    before, after = (abs(level - known_median(own)) for level in _levels(series, at, own))
    if not (size >= least_ratio(series) and abs(kept) <= CLEAR * size and after > before):
        return None
    before_s, after_s = float(series.time_s[at.row]), float(series.time_s[at.after])
    return Leap(before_s, after_s, by_law, 0.0, abs(kept) / size, at.hidden)


def _levels(series: Series, at: LeapCandidate, ratio: Array) -> tuple[float, float]:
    """Return the medians of a ratio (n,) over the hours before and after a leap; NaN where it is not known."""
    time_s = series.time_s
    low, high = np.searchsorted(time_s, (time_s[at.row] - LAW_S, time_s[at.after] + LAW_S)).tolist()
    return known_median(ratio[low : at.row + 1]), known_median(ratio[at.after : high])


def _change(series: Series, at: LeapCandidate, ratio: Array) -> float:
    """Return the change of a ratio (n,) over the hours about a leap; NaN where it is not known."""
    before, after = _levels(series, at, ratio)
    return after - before


def _at_the_edge(series: Series, at: LeapCandidate, fit: ScaleFit) -> bool:
    """Return whether the map of days is the step that the samples show at the leap.

    The two samples that it joins show it beside what the plant does meanwhile, the levels of some beside their noise.
    """
    x = canonical(series)
    for before, after in (at.sides(x), (float(x[at.row]), float(x[at.after]))):
        if abs(fit.factor * before + fit.constant - after) <= EDGE * abs(after - before):
            return True
    return False


def _large(series: Series, at: LeapCandidate, fit: ScaleFit) -> bool:
    """Return whether the map of days changes the reading at the leap by more than the plant's own faults do."""
    before, _ = at.sides(canonical(series))
    mapped = fit.factor * before + fit.constant
    if not is_ratio(series):
        return abs(mapped - before) >= LEAST.get(unit_of(series.tag.unit).dimension, LEAST_KPA)
    return abs(float(np.log(max(mapped, 1e-9) / max(before, 1e-9)))) >= least_ratio(series)


def _least_leap(series: Series, at: LeapCandidate, after: Array) -> float:
    """Return the smallest median leap of the readings `after` (n,) by a map that is large and, of a leap that the
    samples show, at its edge."""
    x = canonical(series)
    levels = at.sides(x)
    if is_ratio(series):
        # Of a rise and a fall by one ratio the fall is the smaller change.
        least = abs(levels[0]) * -float(np.expm1(-least_ratio(series)))
    else:
        least = LEAST.get(unit_of(series.tag.unit).dimension, LEAST_KPA)
    shares = [least / max(abs(levels[0]), 1e-9)]
    if not at.hidden:
        pairs = levels, (float(x[at.row]), float(x[at.after]))
        least = max(least, (1.0 - EDGE) * min(abs(end - start) for start, end in pairs))
        shares.append((1.0 - EDGE) * min(abs(end - start) / max(abs(start), 1e-9) for start, end in pairs))
    share = max(shares)
    return min(least, share / (1.0 + share) * known_median(np.abs(after)))


def _fewest(x: Array, after: Mask) -> int:
    """Return the known readings (m,) of the side of a leap that has fewer."""
    known = np.isfinite(x)
    return int(min((known & after).sum(), (known & ~after).sum()))
