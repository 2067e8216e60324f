"""One cell of a cooling tower at rest, by Merkel's method in the effectiveness-NTU form. Pure functions of arrays.

    m_a  = m_a0 speed air rho/rho0                                   air flow; speed as a share of full
    x    = 1 - (1 - x_0 uniformity) (m_w0/m_w)^1.5                   wetted share of the plan: the rest passes air dry
    Me   = fill Me_0 ((m_w/(x m_a)) / (m_w0/(x_0 m_a0)))^-n          law of the fill
    NTU  = Me m_w/(x m_a),  m* = x m_a C_s/(m_w c_p),  C_s = (h_s(T_in) - h_s(T_out))/(T_in - T_out)
    eps  = (1 - e^(-NTU (1-m*)))/(1 - m* e^(-NTU (1-m*)))
    Q    = eps x m_a (h_s(T_in) - h_in),  T_out = T_in - Q/(m_w c_p)
    fan  = P_i + P_0 speed^3 (rho/rho0) air^-kappa           P_i: losses of motor and drive at any speed

Sources: Braun, Klein & Mitchell, ASHRAE Trans. 95 (1989) 164 (effectiveness, effective surface for the evaporation);
Kloppers & Kroeger, Int. J. Heat Mass Transfer 48 (2005) 765 (law of the fill).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.tower import air as moist
from twin.tower.air import CP_WATER, Array

Rows = NDArray[np.intp] | NDArray[np.bool_] | slice
"""Rows of arrays (n,)."""
WETTED = 0.94
"""Wetted share of the plan of a clean cell at design flow, x_0."""
STARVING = 1.5
"""Power by which nozzles starve as the flow falls."""
PASSES = 6
"""Passes of the fixed point for C_s: the error is below 1e-3 K for ranges up to 15 K."""
KAPPA = -1.3
"""Power of the air in the fan's power, negative: mean of 0.4 by fouling of the path and -3 by a slipping belt."""
LEAST_AIR = 0.02
"""Share of the design air flow that passes with the fan at rest, by free convection."""


@dataclass(frozen=True)
class Inputs:
    """Operating points of a cell, arrays (n,): degC, kg/s, shares of full, kPa."""

    t_in: Array
    m_w: Array
    speed: Array
    dry: Array
    wet: Array
    pressure: Array

    def take(self, rows: Rows) -> Inputs:
        """Return the operating points at these rows."""
        return Inputs(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Design:
    """Clean cell, as commissioned: flows kg/s, power kW, density kg/m3; `evaporation` scales Merkel's; `idle` kW."""

    m_w0: float
    m_a0: float
    merkel: float
    exponent: float
    power: float
    density: float
    kappa: float = 0.0
    speed_exponent: float = 3.0
    evaporation: float = 1.0
    idle: float = 0.0


@dataclass(frozen=True)
class CellDeviations:
    """Deviations of a cell from the clean one: multipliers, and the bias of the outlet thermometer, K."""

    fill: float | Array = 1.0
    air: float | Array = 1.0
    uniformity: float | Array = 1.0
    bias: float | Array = 0.0


@dataclass(frozen=True)
class CellOutputs:
    """Water leaving the fill degC, heat W, evaporation kg/s, fan power kW, air flow kg/s, arrays (n,)."""

    t_out: Array
    heat: Array
    evaporation: Array
    power: Array
    m_a: Array


def solve_cell(
    u: Inputs, design: Design, deviations: CellDeviations = CellDeviations(), *, with_evaporation: bool = True
) -> CellOutputs:
    """Return what the cell does at rest at each operating point; without water its outlet is its inlet.

    Parameters
    ----------
    with_evaporation
        False leaves the evaporation NaN, which saves a third of the time.
    """
    ratio_in = np.maximum(moist.ratio_from_wet_bulb(u.dry, u.wet, u.pressure), 0.0)
    h_in = moist.enthalpy(u.dry, ratio_in)
    rho = moist.density(u.dry, ratio_in, u.pressure)
    speed = np.maximum(u.speed, LEAST_AIR)
    m_a = design.m_a0 * speed * deviations.air * rho / design.density
    m_w = np.maximum(u.m_w, 1e-3 * design.m_w0)
    wetted = np.clip(1.0 - (1.0 - WETTED * deviations.uniformity) * (design.m_w0 / m_w) ** STARVING, 0.05, 1.0)
    wet_air = wetted * m_a
    loading = m_w / wet_air
    number = deviations.fill * design.merkel * (loading * WETTED * design.m_a0 / design.m_w0) ** -design.exponent
    ntu = number * loading
    h_hot = moist.saturated_enthalpy(u.t_in, u.pressure)
    t_out = 0.5 * (u.t_in + u.wet)
    for _ in range(PASSES):
        fall = np.where(np.abs(u.t_in - t_out) < 0.05, 0.05, u.t_in - t_out)
        slope = (h_hot - moist.saturated_enthalpy(u.t_in - fall, u.pressure)) / fall
        ratio = wet_air * slope / (m_w * CP_WATER)
        heat = counterflow_effectiveness(ntu, ratio) * wet_air * (h_hot - h_in)
        t_out = u.t_in - heat / (m_w * CP_WATER)
    lost = np.full_like(t_out, np.nan)
    if with_evaporation:
        lost = design.evaporation * _evaporation(ntu, wet_air, h_in, heat, ratio_in, u.pressure)
    shaft = design.power * speed**design.speed_exponent * rho / design.density
    power = design.idle + shaft * deviations.air**-design.kappa
    return CellOutputs(t_out, heat, lost, power, m_a)


def counterflow_effectiveness(ntu: Array, ratio: Array) -> Array:
    """Return the effectiveness of counter-flow; NTU/(1 + NTU) where the capacities are equal."""
    x = ntu * (1.0 - ratio)
    near = np.abs(x) < 1e-6
    e = np.exp(-np.clip(np.where(near, 1.0, x), -50.0, 50.0))
    return np.where(near, ntu / (1.0 + ntu), (1.0 - e) / (1.0 - ratio * e))


def _evaporation(ntu: Array, wet_air: Array, h_in: Array, heat: Array, ratio_in: Array, pressure: Array) -> Array:
    """Return what evaporates, kg/s, from the effective surface whose saturated enthalpy drives the air's rise."""
    share = 1.0 - np.exp(-np.minimum(ntu, 50.0))
    surface = h_in + heat / wet_air / share
    return wet_air * share * (_ratio_at(surface, pressure) - ratio_in)


def _ratio_at(enthalpy: Array, pressure: Array) -> Array:
    """Return the humidity ratio of saturated air of this enthalpy, by Newton's method on the temperature."""
    t = np.clip((enthalpy - 1.0e4) / 3.0e3, -10.0, 60.0)
    for _ in range(8):
        h = moist.saturated_enthalpy(t, pressure)
        slope = (moist.saturated_enthalpy(t + 0.01, pressure) - h) / 0.01
        t = np.clip(t - (h - enthalpy) / slope, -40.0, 90.0)
    return moist.saturated_ratio(t, pressure)
