"""Minutes of an aligned record as operating points of a cell, and as steady blocks for a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin.first_order_lag import lagged
from twin.tower.air import SEA_LEVEL_KPA, Array
from twin.tower.cell import Inputs
from twin.tower.effects import CellEffect, patterns
from twin.tower.estimates import Blocks
from twin.tower.model import Operation
from twin.tower.smoother import BLOCK_S

FOLLOWING_MIN = 1.5
"""Time constant with which the flume and its thermometer follow the fill: film and flume a minute, thermowell half of
one."""
SETTLED_MIN = 15
"""After a change of fan, flow or bypass, and after a start, until a minute counts as steady."""
MOVED = {"speed": 0.04, "flow": 0.05, "bypass": 0.03, "t_in": 1.0}
"""Changes within 5 minutes that disturb a steady state: of full speed, of design flow, of the valve, and K."""
FLOWING = 0.2
"""Share of design flow above which a cell runs."""
DAY_MIN = 1440
MOST_CONTRADICTED = 0.5
"""Share of a day's outlets that contradict other readings, from which none of the day is used: more are wrong than
right."""
OFF_CHECK = 4 + 8
"""Bits of `check`: outlet below wet bulb, outlet above inlet."""
MEASURED, LINKED = 1, 3


@dataclass(frozen=True)
class Minutes:
    """Minutes of a cell (n,): time, operating point, outlet reading and fan power with NaN where no raw sample is.

    `known`: the inputs are known and water flows. `steady`: nothing that matters has moved for a while.
    """

    time_s: Array
    operation: Operation
    outlet: Array
    power: Array
    known: NDArray[np.bool_]
    steady: NDArray[np.bool_]
    regime: NDArray[np.uint8]

    def part(self, rows: slice) -> Minutes:
        """Return the minutes `rows`."""
        return Minutes(
            self.time_s[rows],
            self.operation.take(rows),
            self.outlet[rows],
            self.power[rows],
            self.known[rows],
            self.steady[rows],
            self.regime[rows],
        )

    def without(self, rows: NDArray[np.bool_]) -> Minutes:
        """Return the minutes with `rows` (n,) as if nothing were known of them."""
        unread = np.where(rows, np.nan, self.outlet), np.where(rows, np.nan, self.power)
        return replace(self, outlet=unread[0], power=unread[1], known=self.known & ~rows, steady=self.steady & ~rows)


def minutes_of(
    time_s: Array,
    columns: Mapping[str, Array],
    origin: Mapping[str, NDArray[np.uint8]],
    m_w0: float,
    bypass_share: float,
    effects: Sequence[CellEffect] = (),
    site_kPa: float = SEA_LEVEL_KPA,
) -> Minutes:
    """Return the minutes of an aligned record's columns.

    Parameters
    ----------
    time_s
        (n,) s since 1970.
    columns, origin
        (n,) each, as in the aligned record.
    m_w0
        Design flow, kg/s.
    bypass_share
        Of the water past the fill when open.
    effects
        Of the cell's model.
    site_kPa
        Air pressure of the site, where the record has none.
    """
    n = len(time_s)

    def column(name: str, otherwise: float = np.nan) -> Array:
        return columns.get(name, np.full(n, otherwise))

    wet = np.where(np.isfinite(column("wet_C")), column("wet_C"), column("wet_rh_C"))
    speed = np.where(np.isfinite(column("fan_speed_pct")), column("fan_speed_pct"), column("fan_command_pct")) / 100.0
    pressure = _filled(column("pressure_kPa"), site_kPa)
    share = bypass_share * np.clip(np.nan_to_num(column("bypass_pct")) / 100.0, 0.0, 1.0)
    dry = np.maximum(column("dry_C"), wet)
    inputs = Inputs(column("t_in_C"), column("m_w_kg_s"), np.clip(speed, 0.0, 1.2), dry, wet, pressure)
    operation = Operation(
        inputs,
        share,
        _filled(column("wind_m_s"), 3.0),
        _filled(column("wind_deg"), 0.0),
        np.clip(_filled(column("neighbours_speed_pct"), 100.0) / 100.0, 0.0, 1.2),
        patterns(effects, time_s, columns, m_w0),
    )
    known = (
        np.isfinite(inputs.t_in) & np.isfinite(inputs.m_w) & np.isfinite(speed) & np.isfinite(dry) & np.isfinite(wet)
    )
    known &= np.nan_to_num(inputs.m_w) > FLOWING * m_w0
    known &= np.nan_to_num(inputs.t_in - wet) > 0.5
    t_out, power = column("t_out_C"), column("fan_power_kW")
    bad = contradicted(column("check"), np.isfinite(t_out))
    outlet = np.where(_sampled(origin, "t_out_C", n) & ~bad, t_out, np.nan)
    power = np.where(_sampled(origin, "fan_power_kW", n) & (power > 0.0), power, np.nan)
    steady = known & _steady(inputs, share, m_w0, known)
    return Minutes(time_s, operation, outlet, power, known, steady, column("regime", 2.0).astype(np.uint8))


def contradicted(check: Array, there: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the minutes whose outlet contradicts the wet bulb or the inlet, or lies in a day that mostly does (n,).

    A fault lasts: a reading of it that happens to be possible is no better than the others of its day.

    Parameters
    ----------
    check
        Failed checks of each minute (n,), as in the aligned record.
    there
        Minutes with an outlet (n,).
    """
    bad = (np.nan_to_num(check).astype(int) & OFF_CHECK) > 0
    n, half = len(bad), DAY_MIN // 2
    sums = [np.concatenate([[0], np.cumsum(rows)]) for rows in (bad & there, there)]
    low, high = np.maximum(np.arange(n) - half, 0), np.minimum(np.arange(n) + half + 1, n)
    failed, seen = (total[high] - total[low] for total in sums)
    return np.asarray(bad | (failed > MOST_CONTRADICTED * np.maximum(seen, 1)))


def _filled(values: Array, otherwise: float) -> Array:
    """Return values with gaps taken from the nearest minutes before and after; `otherwise` where there are none."""
    there = np.isfinite(values)
    if not there.any():
        return np.full(len(values), otherwise)
    return np.interp(np.arange(len(values)), np.flatnonzero(there), values[there])


def _sampled(origin: Mapping[str, NDArray[np.uint8]], name: str, n: int) -> NDArray[np.bool_]:
    """Return the minutes within which a raw sample lies; all where the record does not say."""
    return origin[name] == MEASURED if name in origin else np.ones(n, dtype=bool)


def _steady(u: Inputs, share: Array, m_w0: float, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    moving = ~known
    for values, most in (
        (u.speed, MOVED["speed"]),
        (u.m_w / m_w0, MOVED["flow"]),
        (share, MOVED["bypass"]),
        (u.t_in, MOVED["t_in"]),
    ):
        shifted = np.full(len(values), np.nan)
        shifted[5:] = values[5:] - values[:-5]
        moving |= np.abs(np.nan_to_num(shifted)) > most
    since = np.arange(len(moving))
    last = np.maximum.accumulate(np.where(moving, since, -SETTLED_MIN - 1))
    return np.asarray(since - last >= SETTLED_MIN)


def first_order_lag(values: Array, known: NDArray[np.bool_], minutes: float = FOLLOWING_MIN) -> Array:
    """Return values (n,) behind a first-order lag of `minutes`; it begins anew after values that are not known."""
    keep = np.exp(-1.0 / minutes)
    followed = np.full(len(values), np.nan)
    edges = np.flatnonzero(np.diff(np.r_[False, known, False].astype(np.int8)))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        followed[a:b] = lagged(values[a:b], keep)
    return followed


def blocks_of(minutes: Minutes) -> tuple[Blocks, NDArray[np.intp]]:
    """Return the steady blocks of the minutes, and the block of each minute (n,), -1 for none."""
    number = np.floor(minutes.time_s / BLOCK_S).astype(np.int64)
    rows = minutes.steady
    _, inverse = np.unique(number[rows], return_inverse=True)
    count = int(inverse.max()) + 1 if rows.any() else 0
    of_minute = np.full(len(rows), -1, dtype=np.intp)
    of_minute[rows] = inverse

    def mean(values: Array) -> Array:
        values = values[rows]
        there = np.isfinite(values)
        total = np.bincount(inverse, np.where(there, values, 0.0), count)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(total / np.bincount(inverse, there, count))

    u, o = minutes.operation.inputs, minutes.operation
    inputs = Inputs(*(mean(getattr(u, name)) for name in u.__dataclass_fields__))
    angle = np.radians(o.wind_deg)
    direction = np.degrees(np.arctan2(mean(np.sin(angle)), mean(np.cos(angle)))) % 360.0
    driven = [mean(column) for column in o.patterns.T] if o.patterns.size else []
    drivers = np.stack(driven, axis=1) if driven else np.zeros((count, 0))
    operation = Operation(inputs, mean(o.bypass), mean(o.wind), direction, mean(o.neighbours), drivers)
    # A mean of the outlet belongs to the minutes with a sample of it; in a steady block the inputs hardly differ.
    with np.errstate(invalid="ignore", divide="ignore"):
        log_power = np.where(minutes.operation.inputs.speed > 0.15, np.log(minutes.power), np.nan)
    return Blocks(mean(minutes.time_s), operation, mean(minutes.outlet), mean(log_power)), of_minute
