"""Air flow of a cell by its fan, buoyancy and wind. Pure functions of arrays.

    V^2 = (n^2 + draft^2 (1 - rho_out/rho_in)/0.05 + 2 wind_air (v / 5 m/s)^2) / that at design        turning fan
    m_a = m_a0 V (rho_in/rho_0) ((rho_out/rho_in) / that at design)^fan_density

Pressures of fan, buoyancy and wind add, and the resistance grows with the square of the flow. A fan moves a volume of
the air where it stands, which is that of the exhaust in an induced draught. A fan at rest adds its own resistance
(`rest`). Wind may stall the draft past it; some air passes all the same (`stalled`).

The exhaust is saturated. Its temperature follows from the effectiveness of the clean cell. The enthalpy of saturated
air above that of very cold air grows about exponentially with the temperature.

Source: Kroeger, Air-Cooled Heat Exchangers and Cooling Towers, 2004, chapter 7 (draft equation of a cell).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.tower import air as moist
from twin.tower.air import CP_WATER, Array
from twin.tower.cell import LEAST_AIR, WETTED, Design, Inputs, counterflow_effectiveness

CALM = 1.5
"""Wind of an acceptance test, m/s."""
STRONG = 5.0
"""Wind at which its constants are given, m/s."""
ABOVE = 30.0e3
"""Enthalpy below that of air at 0 degC of the coldest air, J/kg."""
BUOYANCY = 0.05
"""Share of the entering air's density by which the exhaust is lighter, at which the draft is given."""
LEFT = 0.2
"""Share of a turning fan's air flow that no wind takes."""
DEPRESSION_K = 5.0
"""Dry bulb above the wet bulb at a design point, of which a datasheet gives the wet bulb alone."""
TURNING = 0.1
"""Share of full speed from which a fan turns."""
LEAST_WAY = 1.0e3
"""Least difference of enthalpy that a rise is a share of, J/kg: a third of a kelvin."""


def exhaust_density(design: Design, u: Inputs, draft: float) -> Array:
    """Return the density of the exhaust over that of the entering air (n,).

    Parameters
    ----------
    design
        Clean cell.
    u
        Inputs of the fill.
    draft
        Share of design air by buoyancy alone.
    """
    cold, hot = (moist.saturated_enthalpy(t, u.pressure) for t in (u.wet, u.t_in))
    way = np.maximum(u.t_in - u.wet, 0.1)
    turning = np.hypot(np.maximum(u.speed, 0.0), max(draft, LEAST_AIR))
    loading = np.maximum(u.m_w, 1e-3 * design.m_w0) / (WETTED * design.m_a0 * turning)
    ntu = design.merkel * (loading * WETTED * design.m_a0 / design.m_w0) ** -design.exponent * loading
    share = counterflow_effectiveness(ntu, np.maximum(hot - cold, LEAST_WAY) / way / (loading * CP_WATER))
    growth = np.log(np.maximum((hot + ABOVE) / (cold + ABOVE), 1.0 + 1e-6))
    exhaust = u.wet + way * np.log1p(share * np.expm1(growth)) / growth
    outside = moist.density(u.dry, np.maximum(moist.ratio_from_wet_bulb(u.dry, u.wet, u.pressure), 0.0), u.pressure)
    return np.asarray(moist.density(exhaust, moist.saturated_ratio(exhaust, u.pressure), u.pressure) / outside)


def exhaust_density_at(design: Design, inlet: float, wet: float) -> float:
    """Return the density of the exhaust over that of the entering air at a design point, degC."""
    at = (inlet, design.m_w0, 1.0, wet + DEPRESSION_K, wet, moist.SEA_LEVEL_KPA)
    return float(exhaust_density(design, Inputs(*(np.array([v]) for v in at)), 0.0)[0])


def effective_speed(speed: Array, lighter: Array, wind: Array, q: Mapping[str, float], at_design: float) -> Array:
    """Return the fan's speed with which the air would flow as it does, share of full (n,); 1 at design.

    Parameters
    ----------
    speed
        Of the fan, share of full (n,).
    lighter
        Density of the exhaust over that of the entering air (n,); `at_design` at the design point.
    wind
        m/s (n,).
    q
        Constants by name: draft, wind_air, rest, stalled.
    """
    at_rating = _pressure(np.array([1.0]), np.array([at_design]), np.array([CALM]), q)
    design = max(float(at_rating[0]), LEAST_AIR)
    driven = np.sqrt(np.maximum(_pressure(speed, lighter, wind, q) / design, (LEFT * speed) ** 2))
    turns = np.clip(speed / TURNING, 0.0, 1.0)
    flow = driven * (q["rest"] + (1.0 - q["rest"]) * turns)
    return np.asarray(np.maximum(np.hypot(flow, max(q["stalled"], 0.0) * (1.0 - turns)), LEAST_AIR))


def _pressure(speed: Array, lighter: Array, wind: Array, q: Mapping[str, float]) -> Array:
    """Return the pressure of fan, buoyancy and wind over that of the fan at full speed."""
    draft = max(q["draft"], 0.0) ** 2 * np.maximum(1.0 - lighter, 0.0) / BUOYANCY
    return np.asarray(np.maximum(speed, 0.0) ** 2 + draft + 2.0 * q["wind_air"] * (wind / STRONG) ** 2)
