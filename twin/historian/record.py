"""Minutes of a cell: its own columns, those of its station, checks and regimes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin.historian.checks import check_flags
from twin.historian.columns import OF_CELL, OF_STATION, Column, column_unit
from twin.historian.defects.quality import JOINED_S
from twin.historian.minutes import How, held_minutes, mean_minutes, minute_edges, staleness_min
from twin.historian.regimes import regimes
from twin.historian.tags import Array, Defect, Series, longest_interval_s
from twin.historian.units import SPEEDS, full_speed_of, unit_of
from twin.tower.air import wet_bulb

CLOSURE_K = 0.35
"""Difference to the wet bulb of dry bulb and humidity, above which a measured wet bulb is dropped (the paper)."""
CLOSURE_MIN = 30
"""Minutes over which the closure is averaged: instruments of different lag differ for minutes at each gust."""
NEEDED = ("t_in_C", "t_out_C", "m_w_kg_s", "fan_speed_pct", "dry_C")
"""Columns without which a minute says nothing of the cell; besides, one of the wet bulbs."""

AlignedColumns = dict[str, NDArray[np.generic]]


@dataclass(frozen=True)
class SharedMinutes:
    """Columns of the station, and the speed of every fan by cell."""

    minute_s: Array
    columns: AlignedColumns
    fans: Mapping[int, Array]


@dataclass(frozen=True)
class CellMinutes:
    """Minutes of a cell: beginning of each, columns, share of complete minutes, and remarks."""

    minute_s: Array
    columns: AlignedColumns
    complete: float
    remarks: tuple[str, ...] = field(default=())


def shared_minutes(
    series: Sequence[Series], start_s: float, end_s: float, full_speed: str, pressure_kPa: float
) -> SharedMinutes:
    """Return the station's columns on a grid of minutes.

    Parameters
    ----------
    series
        Series of all tags of the station.
    start_s, end_s
        The grid begins at the minute of the one and ends at that of the other, s since 1970.
    full_speed
        Meaning of 100 % fan speed, from the datasheet.
    pressure_kPa
        Air pressure of the site, where no tag has it.
    """
    edges = minute_edges(start_s, end_s)
    columns: AlignedColumns = {}
    for role, column in OF_STATION.items():
        columns |= _columns(_of(series, role, None), column, edges, full_speed)
    columns |= _wet_bulbs(columns, pressure_kPa)
    fans = {
        one.tag.cell: _columns(one, OF_CELL["fan_speed"], edges, full_speed)["fan_speed_pct"].astype(np.float64)
        for one in series
        if one.tag.role == "fan_speed" and one.tag.cell is not None
    }
    return SharedMinutes(edges[:-1], columns, fans)


def cell_minutes(
    series: Sequence[Series], shared: SharedMinutes, cell: int, disturbed: NDArray[np.bool_], full_speed: str
) -> CellMinutes:
    """Return the minutes of a cell with those of its station, checks and regimes.

    Parameters
    ----------
    series
        Repaired series of the whole station.
    shared
        Minutes of the station, n of them.
    cell
        Number of the cell, from 1.
    disturbed
        (n,) True for minutes that an event of the plant disturbs.
    full_speed
        Speed of 100 %, as a number with its unit: a speed in Hz or rpm becomes per cent of it.

    Returns
    -------
    CellMinutes
        Columns (n,) by name, in the units of their suffixes.
    """
    edges = np.append(shared.minute_s, shared.minute_s[-1] + 60.0)
    columns: AlignedColumns = {}
    for role, column in OF_CELL.items():
        columns |= _columns(_of(series, role, cell), column, edges, full_speed)
    others = [speed for number, speed in shared.fans.items() if number != cell]
    columns["neighbours_speed_pct"] = _mean(others, len(shared.minute_s)).astype(np.float32)
    columns |= shared.columns
    check, remarks = check_flags(columns, shared.minute_s)
    columns["check"] = check
    columns["disturbed"] = disturbed
    columns["regime"] = regimes(
        flow=_wide(columns["m_w_kg_s"]),
        in_service=_wide(columns["in_service"]),
        command=_wide(columns["fan_command_pct"]),
        speed=_wide(columns["fan_speed_pct"]),
        bypass=_wide(columns["bypass_pct"]),
        fault=_wide(columns["fan_fault"]),
        disturbed=disturbed,
    )
    known = np.isfinite(_wide(columns["wet_C"])) | np.isfinite(_wide(columns["wet_rh_C"]))
    for name in NEEDED:
        known &= np.isfinite(_wide(columns[name]))
    return CellMinutes(shared.minute_s, columns, float(known.mean()), tuple(f"cell {cell}: {text}" for text in remarks))


def _wide(values: NDArray[np.generic]) -> Array:
    return np.asarray(values, dtype=np.float64)


def _of(series: Sequence[Series], role: str, cell: int | None) -> Series | None:
    return next((one for one in series if one.tag.role == role and (cell is None or one.tag.cell == cell)), None)


def _columns(series: Series | None, column: Column, edges: Array, full_speed: str) -> AlignedColumns:
    """Return the column of a tag with its origin and staleness; missing throughout without a tag."""
    n = len(edges) - 1
    if series is None:
        return {column.name: np.full(n, np.nan, dtype=np.float32)}
    series = canonical(series, full_speed)
    series = _plausible(series, column)
    limit = longest_interval_s(series)
    if column.name == "wind_deg":
        values, how = _direction(series, edges, limit)
    elif column.filling == "held":
        values, how = held_minutes(series, edges, limit)
    else:
        values, how = mean_minutes(series, edges, limit)
    return {
        column.name: values.astype(np.float32),
        f"{column.name}_how": how,
        f"{column.name}_age_min": staleness_min(series, edges).astype(np.float32),
    }


def canonical(series: Series, full_speed: str) -> Series:
    """Return the series in the record's unit; a speed in Hz or rpm becomes % of `full_speed`."""
    from dataclasses import replace

    unit = unit_of(series.tag.unit)
    value = unit.scale * series.value + unit.offset
    if unit.dimension in SPEEDS:
        value = 100.0 * value / full_speed_of(full_speed)[0]
    return replace(series, value=value)


def _plausible(series: Series, column: Column) -> Series:
    """Return a series, in the record's unit, without what its column cannot have, which becomes holes."""
    return series.without(_out_of_range(series, column))


def _out_of_range(series: Series, column: Column) -> list[tuple[float, float]]:
    """Return from the first sample of each run that its column cannot have to the last, s since 1970."""
    outside = ~((series.value >= column.low) & (series.value <= column.high))
    edge = np.diff(np.concatenate([[0], outside.astype(np.int8), [0]]))
    first, last = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
    return list(zip(series.time_s[first].tolist(), series.time_s[last].tolist(), strict=True))


def _joined(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the spans, those that are close to one another as one."""
    joined: list[tuple[float, float]] = []
    for start, end in spans:
        if joined and start - joined[-1][1] <= JOINED_S:
            joined[-1] = joined[-1][0], end
        else:
            joined.append((start, end))
    return joined


def out_of_range(series: Sequence[Series], full_speed: str) -> list[Defect]:
    """Return the spans in which tags hold values that their columns cannot have.

    Parameters
    ----------
    series
        Good samples of the tags, in their own units.
    full_speed
        Speed of 100 %, with its unit.
    """
    found = []
    for one in series:
        column = OF_CELL.get(one.tag.role) or OF_STATION.get(one.tag.role)
        if column is None:
            continue
        inside = canonical(one, full_speed)
        for start, end in _joined(_out_of_range(inside, column)):
            part = inside.between(start, float(np.nextafter(end, np.inf)))
            values = part.value[(part.value < column.low) | (part.value > column.high)]
            says = (
                f"{one.tag.name} holds {len(values)} values such as {values[0]:.4g} {column_unit(column)}, outside "
                f"{column.low:g} to {column.high:g}"
            )
            found.append(Defect("out_of_range", (one.tag.name,), start, end, says, "left out"))
    return found


def _direction(series: Series, edges: Array, limit: float) -> tuple[Array, NDArray[np.uint8]]:
    """Return the mean direction of each minute by its components: the mean of 359 and 1 is 0."""
    from dataclasses import replace

    angle = np.deg2rad(series.value)
    east, how = mean_minutes(replace(series, value=np.sin(angle)), edges, limit)
    north, _ = mean_minutes(replace(series, value=np.cos(angle)), edges, limit)
    return np.mod(np.rad2deg(np.arctan2(east, north)), 360.0), how


def _mean(parts: Sequence[Array], n: int) -> Array:
    """Return the mean of those that are known (n,)."""
    if not parts:
        return np.full(n, np.nan)
    stack = np.stack(parts)
    known = np.isfinite(stack)
    count = known.sum(axis=0)
    return np.asarray(np.where(count > 0, np.where(known, stack, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan))


def _wet_bulbs(columns: AlignedColumns, pressure_kPa: float) -> AlignedColumns:
    """Return wet bulb of dry bulb and humidity, the closure, and the measured wet bulb where it closes."""
    dry, measured = _wide(columns["dry_C"]), _wide(columns["wet_C"])
    pressure = _wide(columns["pressure_kPa"])
    pressure = np.where(np.isfinite(pressure), pressure, pressure_kPa)
    shares = [_wide(columns[name]) for name in ("rh_pct", "rh2_pct")]
    share = _mean(shares, len(dry))
    known = np.isfinite(dry) & np.isfinite(share)
    expected = np.full(len(dry), np.nan)
    if known.any():
        expected[known] = wet_bulb(dry[known], share[known] / 100.0, pressure[known])
    closure = measured - expected
    usual = _smooth(closure, CLOSURE_MIN)
    # Where no humidity is known there is nothing to close against: the wet bulb is kept unless above the dry bulb.
    apart = (np.abs(np.nan_to_num(usual)) > CLOSURE_K) | (np.nan_to_num(measured - dry, nan=-1.0) > CLOSURE_K)
    how = np.asarray(columns.get("wet_C_how", np.zeros(len(dry), dtype=np.uint8)))
    return {
        "wet_C": np.where(apart, np.nan, measured).astype(np.float32),
        "wet_C_how": np.where(apart, np.uint8(How.MISSING), how).astype(np.uint8),
        "wet_rh_C": expected.astype(np.float32),
        "closure_K": closure.astype(np.float32),
    }


def _smooth(x: Array, width: int) -> Array:
    """Return the mean of what is known of the last `width` values; NaN where nothing is."""
    known = np.isfinite(x)
    total = np.concatenate([[0.0], np.cumsum(np.where(known, x, 0.0))])
    count = np.concatenate([[0], np.cumsum(known)])
    index = np.arange(1, len(x) + 1)
    before = np.maximum(index - width, 0)
    n = count[index] - count[before]
    return np.asarray(np.where(n > 0, (total[index] - total[before]) / np.maximum(n, 1), np.nan))
