"""Effects that a clean cell lacks: a driver from the record, a path by which it acts, and a size.

    pattern     g(t) = driver by minute, from the effect's onset on: 0 where it does not act
    exhaust     h at the fill += size g (h_exhaust - h)                     air that comes back, of this cell or others
    past_fill   T_out += size g (T_in - T_out)                             hot water that leaks past the fill
    wetted      wetted share of the plan -= size g                         nozzles that starve
    outlet      T_out += size g                                            heat of the channel, or of its thermometer
    inlet, wet_bulb, water                                                 errors of these readings, K, K, logarithm

h is the enthalpy of saturated air at the wet bulb, which mixing conserves. That of the exhaust is the cell's own: the
air that enters the fill takes up the heat of its water. The cell's recirculation as a constant of a record (`model`) is
a fifth as large, and linear: its prior is wider than the difference. The rest is the same physics as the cell's own, so
a refit with an effect stays a fit of Merkel's method.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from twin.tower.air import Array, saturated_enthalpy

if TYPE_CHECKING:
    from twin.tower.model import Operation

PATHS = ("exhaust", "past_fill", "wetted", "outlet", "inlet", "wet_bulb", "water")
DRIVERS = ("always", "wind_direction", "wind_speed", "neighbours_speed", "solar", "low_flow", "column")
UNITS = {
    "exhaust": "1",
    "past_fill": "1",
    "wetted": "1",
    "outlet": "K",
    "inlet": "K",
    "wet_bulb": "K",
    "water": "1",
}
LATITUDE = 40.0
"""Degrees north, for the sun's height where no irradiance is recorded: between 25 and 55 the shape of a day hardly
differs, and the size takes the rest."""
WIND_M_S = 5.0
"""Wind speed at which a size is given, m/s."""
NEAR_K = 0.01
"""Difference by which a slope is taken, K."""
NEWTON = 3
"""Steps of Newton's method on a wet bulb: the last one moves less than 0.01 K for a share of 0.3 between 0 and 30
degC."""
MOST_SHARE = 0.6
"""Bound of a share that an effect may reach in any minute."""
HOUR_S, DAY_S, YEAR_S = 3600.0, 86400.0, 365.25 * 86400.0


@dataclass(frozen=True)
class CellEffect:
    """An effect on a cell.

    Attributes
    ----------
    kind
        Its name in an answer: recirculation, bypass_leak, ...
    path, driver
        As in `PATHS` and `DRIVERS`.
    form
        Direction from which the wind brings it, deg; hour of the sun's highest stand, UTC; flow below which it acts, as
        a share of design. None for other drivers.
    column
        Of the record, its centre and the spread that counts as 1, for the driver "column".
    onset_s
        Since when, s since 1970; None is all along.
    size
        At driver 1; its standard deviation `sd`.
    """

    kind: str
    path: str
    driver: str
    form: float | None = None
    column: str = ""
    centre: float = 0.0
    spread: float = 1.0
    onset_s: float | None = None
    size: float = 0.0
    sd: float = 0.0

    def named_driver(self) -> str:
        """Return the driver's name in an answer."""
        names = {"always": "bypass" if self.path == "past_fill" else "none", "low_flow": "water_flow"}
        return self.column if self.driver == "column" else names.get(self.driver, self.driver)


def pattern(effect: CellEffect, time_s: Array, columns: Mapping[str, Array], m_w0: float) -> Array:
    """Return the driver of an effect by minute (n,), 1 where it acts with its full size; gaps are bridged.

    Parameters
    ----------
    columns
        Of the aligned record.
    m_w0
        Design flow, kg/s.
    """
    n = len(time_s)

    def column(name: str) -> Array:
        return complete(columns.get(name, np.full(n, np.nan)))

    if effect.driver == "always":
        values = np.ones(n)
    elif effect.driver == "wind_direction":
        angle = np.radians(column("wind_deg") - float(effect.form or 0.0))
        values = column("wind_m_s") / WIND_M_S * np.maximum(np.cos(angle), 0.0)
    elif effect.driver == "wind_speed":
        values = column("wind_m_s") / WIND_M_S
    elif effect.driver == "neighbours_speed":
        values = np.clip(column("neighbours_speed_pct") / 100.0, 0.0, 1.2)
    elif effect.driver == "solar":
        values = sun_height(time_s, float(effect.form or 12.0))
    elif effect.driver == "low_flow":
        values = np.maximum(float(effect.form or 0.0) - column("m_w_kg_s") / m_w0, 0.0)
    else:
        values = np.clip((column(effect.column) - effect.centre) / effect.spread, -3.0, 3.0)
    if effect.onset_s is not None:
        values = values * (time_s >= effect.onset_s)
    return np.nan_to_num(values)


def complete(values: Array) -> Array:
    """Return values with their gaps bridged by straight lines; 0 throughout where there are none."""
    there = np.isfinite(values)
    if not there.any():
        return np.zeros(len(values))
    return np.interp(np.arange(len(values)), np.flatnonzero(there), values[there])


def sun_height(time_s: Array, noon_h: float) -> Array:
    """Return the sine of the sun's elevation, 0 at night (n,). Source: Cooper, Solar Energy 12 (1969) 333
    (declination).

    Parameters
    ----------
    noon_h
        Hour of its highest stand, UTC.
    """
    day = np.mod(time_s, YEAR_S) / DAY_S
    declination = np.radians(23.45 * np.sin(2.0 * np.pi * (284.0 + day) / 365.0))
    hour = 2.0 * np.pi * (np.mod(time_s, DAY_S) / HOUR_S - noon_h) / 24.0
    phi = np.radians(LATITUDE)
    return np.maximum(np.sin(phi) * np.sin(declination) + np.cos(phi) * np.cos(declination) * np.cos(hour), 0.0)


def patterns(effects: Sequence[CellEffect], time_s: Array, columns: Mapping[str, Array], m_w0: float) -> Array:
    """Return the drivers of effects by minute (n, k)."""
    found = [pattern(one, time_s, columns, m_w0) for one in effects]
    return np.stack(found, axis=1) if found else np.zeros((len(time_s), 0))


def before_fill(
    effects: Sequence[CellEffect], o: Operation, slow: Array, rise: Callable[[Operation, Array], Array]
) -> tuple[Operation, Array]:
    """Return operating points and slow deviations (n, 5) as the effects change them.

    Parameters
    ----------
    rise
        Function of both: the air's rise of enthalpy in the cell, as a share of the way to that of saturated air at the
        hot water (n,).
    """
    for k, one in enumerate(effects):
        x, u = one.size * o.patterns[:, k], o.inputs
        if one.path == "exhaust":
            share = np.clip(x, -MOST_SHARE, MOST_SHARE)
            wet = wet_bulb_with_exhaust(u.wet, u.t_in, share, rise(o, slow), u.pressure)
            u = replace(u, wet=wet, dry=np.maximum(u.dry, wet))
        elif one.path == "inlet":
            u = replace(u, t_in=u.t_in + x)
        elif one.path == "wet_bulb":
            wet = u.wet + x
            u = replace(u, wet=wet, dry=np.maximum(u.dry, wet))
        elif one.path == "water":
            u = replace(u, m_w=u.m_w * np.exp(np.clip(x, -1.0, 1.0)))
        elif one.path == "wetted":
            slow = slow.copy()
            slow[:, 2] -= x
        o = replace(o, inputs=u)
    return o, slow


def wet_bulb_with_exhaust(wet: Array, hot: Array, share: Array, rise: Array, pressure: Array) -> Array:
    """Return the wet bulb of air that enters a cell with a share of the cell's exhaust, degC (n,).

    The mixture has the mean enthalpy (adiabatic mixing, ASHRAE Handbook of Fundamentals, chapter 1), and the exhaust is
    that of the air that entered, which had exhaust in it: with ambient air h, saturated air at the hot water h_w, share
    s and rise r, the entering air has ((1 - s) h + s r h_w) / (1 - s (1 - r)).

    Parameters
    ----------
    wet, hot
        Wet bulb of the ambient air and temperature of the hot water, degC (n,).
    share
        Of the exhaust, 1 (n,).
    rise
        Of the air's enthalpy in the cell, as a share of the way to that at the hot water, 1 (n,).
    pressure
        Of the air, kPa (n,).
    """
    ambient, most = saturated_enthalpy(wet, pressure), saturated_enthalpy(hot, pressure)
    wanted = ((1.0 - share) * ambient + share * rise * most) / (1.0 - share * (1.0 - rise))
    mixed = wet
    for _ in range(NEWTON):
        found = saturated_enthalpy(mixed, pressure)
        slope = (saturated_enthalpy(mixed + NEAR_K, pressure) - found) / NEAR_K
        mixed = mixed - (found - wanted) / slope
    return np.asarray(mixed)


def after_fill(effects: Sequence[CellEffect], o: Operation, t_in: Array, t_out: Array) -> Array:
    """Return the outlet's temperature as the effects between fill and thermometer change it, degC (n,)."""
    for k, one in enumerate(effects):
        x = one.size * o.patterns[:, k]
        if one.path == "past_fill":
            t_out = t_out + np.clip(x, -MOST_SHARE, MOST_SHARE) * (t_in - t_out)
        elif one.path == "outlet":
            t_out = t_out + x
    return t_out
