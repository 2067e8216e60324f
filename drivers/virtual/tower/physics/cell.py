"""One cell of the virtual station, compiled: fan against resistance, water and air in sectors, wind and recirculation.

A cell is a row of numbers in the order of `CELL`; its degradation a row in the order of `STATE`. The fan's pressure and
the resistance are relative to those of the clean cell at design. The air that a fan moves is that which leaves the
fill.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.virtual.plant import may_cache
from drivers.virtual.tower.physics.moist_air import (
    CP_AIR,
    CP_VAPOUR,
    CP_WATER,
    LATENT,
    dry_air_density,
    enthalpy,
    saturation,
    wet_bulb,
)
from drivers.virtual.tower.physics.poppe import outlet

CACHE = may_cache()
Array = NDArray[Any]
Leaving = tuple[float, float, float, float, float, float, float]
"""Water degC and kg/s, air kg/s, its temperature and ratio, power of the fan kW, water lost kg/s."""

CELL = (
    "m_w0",
    "m_a0",
    "fill",
    "fill_water",
    "fill_air",
    "fill_hot",
    "spray",
    "rain",
    "starving",
    "dry_air",
    "fan_shut",
    "fan_slope",
    "fan_bend",
    "load_drag",
    "wind_drag",
    "draft",
    "power",
    "drive_loss",
    "density0",
    "t_hot0",
    "recirculation",
    "recirculation_wind",
    "windmill",
)
"""Numbers of a cell: design flows kg/s; Merkel number of the fill at design and its exponents of wetted water and air
loading and of hot-water temperature; Merkel numbers of spray and rain; exponent of starving nozzles; air through a dry
plan over that through a wet one; fan curve (shut-off, slope, bend); resistance by water load, by wind (per (m/s)^2),
draft (per kg/m3 of density difference); fan power kW, loss of the drive; density kg/m3 and hot water degC of design;
share of exhaust that comes back, and per m/s of wind; resistance of a fan at rest."""
STATE = ("fill", "uniformity", "slip", "pitch", "blockage")
"""Degradation of a cell: multiplier of the fill, of the wetted share; share lost by a slipping belt, by the blades'
pitch; relative rise of the resistance."""

(
    M_W0,
    M_A0,
    FILL,
    FILL_WATER,
    FILL_AIR,
    FILL_HOT,
    SPRAY,
    RAIN,
    STARVING,
    DRY_AIR,
    FAN_SHUT,
    FAN_SLOPE,
    FAN_BEND,
    LOAD_DRAG,
    WIND_DRAG,
    DRAFT,
    POWER,
    DRIVE_LOSS,
    DENSITY0,
    T_HOT0,
    RECIRCULATION,
    RECIRCULATION_WIND,
    WINDMILL,
) = range(len(CELL))
S_FILL, S_UNIFORMITY, S_SLIP, S_PITCH, S_BLOCKAGE = range(len(STATE))
LEAST_AIR, GUST_AIR = 0.03, 0.003
"""Share of the design air that passes a cell whose draft the wind stalls, and per m/s of wind through the louvres."""


@njit(cache=CACHE)
def air_flow(
    cell: Array, state: Array, speed: float, water: float, density_out: float, density_in: float, wind: float
) -> float:
    """Return the air flow, as a share of the design's volume, where fan curve and resistance meet.

    `speed` and `water` are shares of full speed and design flow; densities are of dry air, kg/m3.
    """
    n = speed * (1.0 - state[S_SLIP])
    relative = density_out / cell[DENSITY0]
    resistance = (1.0 + state[S_BLOCKAGE]) * (1.0 + cell[LOAD_DRAG] * (water - 1.0))
    head = cell[DRAFT] * (density_in - density_out) - cell[WIND_DRAG] * wind * wind
    # A fan below a fifth of its speed hinders more than it drives.
    idle = cell[WINDMILL] * max(0.0, 1.0 - 5.0 * n)
    a = cell[FAN_BEND] + resistance + idle
    b = n * cell[FAN_SLOPE]
    c = n * n * cell[FAN_SHUT] * (1.0 - state[S_PITCH]) + head / relative
    least = LEAST_AIR + GUST_AIR * wind
    if c <= 0.0:
        return least
    return max((-b + np.sqrt(b * b + 4.0 * a * c)) / (2.0 * a), least)


@njit(cache=CACHE)
def fan_power(cell: Array, state: Array, speed: float, volume: float, density_out: float) -> float:
    """Return the power of the fan's motor, kW; `volume` is the air flow as `air_flow` returns it."""
    if speed < 0.01:
        return 0.0
    n = speed * (1.0 - state[S_SLIP])
    through = volume / max(n, 0.05)
    shaft = (
        n**3
        * density_out
        / cell[DENSITY0]
        * (0.72 + 0.5 * through - 0.22 * through * through)
        * (1.0 - 0.8 * state[S_PITCH])
    )
    return cell[POWER] * (shaft * (1.0 + 0.07 * (1.0 - speed) ** 2) + cell[DRIVE_LOSS] * speed)


@njit(cache=CACHE)
def wetted_share(clean: float, plugged: float, uniformity: float, water: float, starving: float) -> float:
    """Return the wetted share of a sector's plan: nozzles starve as the flow falls."""
    full = clean * (1.0 - plugged * (1.0 - uniformity))
    return min(max(1.0 - (1.0 - full) * max(water, 0.02) ** -starving, 0.05), 1.0)


@njit
def cell_step(
    cell: Array,
    state: Array,
    shares: Array,
    m_w: float,
    speed: float,
    t_in: float,
    t_air: float,
    w_air: float,
    p: float,
    wind: float,
    memory: Array,
) -> Leaving:
    """Return what leaves the cell at rest: water degC and kg/s, air kg/s, its temperature, ratio, kW of the fan, kg/s
    lost.

    `shares (4, sectors)` are water, air, clean wetted share and susceptibility to plugging; `memory (2 sectors + 2)`
    keeps the last solution of each sector and the leaving air's state, and is updated.
    """
    sectors = shares.shape[1]
    t_exit, w_exit = memory[2 * sectors], memory[2 * sectors + 1]
    rho_in = dry_air_density(t_air, w_air, p)
    rho_out = dry_air_density(t_exit, w_exit, p)
    water = m_w / cell[M_W0]
    volume = air_flow(cell, state, speed, water, rho_out, rho_in, wind)
    m_a = cell[M_A0] * volume * rho_out / cell[DENSITY0]
    power = fan_power(cell, state, speed, volume, rho_out)
    i_air = enthalpy(t_air, w_air)
    if m_w < 0.02 * cell[M_W0]:
        memory[2 * sectors] += 0.2 * (t_air - t_exit)
        memory[2 * sectors + 1] += 0.2 * (w_air - w_exit)
        return t_in, m_w, m_a, t_air, w_air, power, 0.0
    t_wet = wet_bulb(t_air, w_air, p)
    hot = (max(t_in, 5.0) / cell[T_HOT0]) ** -cell[FILL_HOT]
    heat_out, m_out, w_sum, i_sum = 0.0, 0.0, 0.0, 0.0
    for j in range(sectors):
        x = wetted_share(
            shares[2, j], shares[3, j], state[S_UNIFORMITY], water * shares[0, j] * sectors, cell[STARVING]
        )
        through_wet = x / (x + cell[DRY_AIR] * (1.0 - x))
        air = m_a * shares[1, j]
        wet_air = air * through_wet
        flow = m_w * shares[0, j]
        load = flow / x * sectors / cell[M_W0]
        gas = wet_air / x * sectors / cell[M_A0]
        ratio = load / gas
        number = state[S_FILL] * cell[FILL] * load ** -cell[FILL_WATER] * gas ** cell[FILL_AIR] * hot
        number += cell[SPRAY] * ratio**-0.5 + cell[RAIN] * ratio**-0.35
        t, w, i = outlet(t_in, flow / wet_air, t_air, w_air, p, t_wet, number, memory[j], memory[sectors + j])
        memory[j], memory[sectors + j] = t, w
        left = flow - wet_air * (w - w_air)
        m_out += left
        heat_out += left * t
        w_sum += wet_air * w + (air - wet_air) * w_air
        i_sum += wet_air * i + (air - wet_air) * i_air
    w_exit, i_exit = w_sum / m_a, i_sum / m_a
    t_exit = leaving_temperature(i_exit, w_exit, p)
    memory[2 * sectors], memory[2 * sectors + 1] = t_exit, w_exit
    return heat_out / m_out, m_out, m_a, t_exit, w_exit, power, m_w - m_out


@njit
def leaving_temperature(i: float, w: float, p: float) -> float:
    """Return the temperature of air by enthalpy and total water, whose droplets it carries where it is
    supersaturated."""
    t = (i - w * LATENT) / (CP_AIR + w * CP_VAPOUR)
    ps = saturation(t)
    if w <= 0.62198 * ps / (p - ps):
        return t
    low, high = t, t + 40.0
    for _ in range(20):
        middle = 0.5 * (low + high)
        ps = saturation(middle)
        ws = 0.62198 * ps / (p - ps)
        if CP_AIR * middle + ws * (LATENT + CP_VAPOUR * middle) + (w - ws) * CP_WATER * middle > i:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@njit
def steady_cell(
    cell: Array,
    state: Array,
    shares: Array,
    m_w: float,
    speed: float,
    t_in: float,
    t_air: float,
    w_air: float,
    p: float,
    wind: float,
    memory: Array,
) -> Leaving:
    """Return `cell_step` once the leaving air and the draft that it makes have settled."""
    result = cell_step(cell, state, shares, m_w, speed, t_in, t_air, w_air, p, wind, memory)
    for _ in range(12):
        result = cell_step(cell, state, shares, m_w, speed, t_in, t_air, w_air, p, wind, memory)
    return result
