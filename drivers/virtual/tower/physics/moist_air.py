"""Moist air of the virtual station, compiled. Temperatures degC, pressures kPa, enthalpies J/kg of dry air, ratios
kg/kg.

Sources: saturation by Buck (1981), coefficients of 1996; wet bulb by adiabatic saturation, below 0 degC over ice. The
coefficients of heat are those of VDI 4670, rounded; none is taken from the twin.
"""

import numpy as np
from numba import njit

from drivers.virtual.plant import may_cache

CACHE = may_cache()
CP_AIR, CP_VAPOUR, CP_WATER, LATENT = 1005.0, 1868.0, 4182.0, 2.5009e6
CP_ICE, MELTING = 2050.0, 3.334e5
MOLAR = 0.62198
R_AIR = 0.28706
"""kJ/(kg K)."""


@njit(cache=CACHE)
def saturation(t: float) -> float:
    """Return the pressure of saturated vapour over water, also below 0 degC, kPa."""
    return 0.61121 * np.exp((18.678 - t / 234.5) * t / (257.14 + t))


@njit(cache=CACHE)
def ice_saturation(t: float) -> float:
    """Return the pressure of saturated vapour over ice, kPa."""
    return 0.61115 * np.exp((23.036 - t / 333.7) * t / (279.82 + t))


@njit(cache=CACHE)
def saturated_ratio(t: float, p: float) -> float:
    """Return the humidity ratio of air saturated over water."""
    ps = saturation(t)
    return MOLAR * ps / (p - ps)


@njit(cache=CACHE)
def enthalpy(t: float, w: float) -> float:
    """Return the enthalpy of moist air."""
    return CP_AIR * t + w * (LATENT + CP_VAPOUR * t)


@njit(cache=CACHE)
def dry_air_density(t: float, w: float, p: float) -> float:
    """Return the mass of dry air in a volume of moist air, kg/m3."""
    return p / (R_AIR * (t + 273.15) * (1.0 + w / MOLAR))


@njit(cache=CACHE)
def wet_bulb(t: float, w: float, p: float) -> float:
    """Return the temperature of adiabatic saturation, by bisection to 1e-5 K."""
    low, high = t - 45.0, t
    h = enthalpy(t, w)
    for _ in range(23):
        middle = 0.5 * (low + high)
        if middle >= 0.0:
            ps, liquid = saturation(middle), CP_WATER * middle
        else:
            ps, liquid = ice_saturation(middle), CP_ICE * middle - MELTING
        ws = MOLAR * ps / (p - ps)
        if enthalpy(middle, ws) - h - (ws - w) * liquid > 0.0:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@njit(cache=CACHE)
def wet_bulbs(t: np.ndarray, w: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return `wet_bulb` of arrays of one shape (n,)."""
    out = np.empty(len(t))
    for k in range(len(t)):
        out[k] = wet_bulb(t[k], w[k], p[k])
    return out


@njit(cache=CACHE)
def ratios(t: np.ndarray, humidity: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the humidity ratios of air by its relative humidity over water, 0 to 1, arrays (n,)."""
    out = np.empty(len(t))
    for k in range(len(t)):
        pv = humidity[k] * saturation(t[k])
        out[k] = MOLAR * pv / (p[k] - pv)
    return out


@njit(cache=CACHE)
def humidities(t: np.ndarray, w: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the relative humidities over water, 0 to 1, of air by its humidity ratio, arrays (n,)."""
    out = np.empty(len(t))
    for k in range(len(t)):
        out[k] = p[k] * w[k] / (MOLAR + w[k]) / saturation(t[k])
    return out
