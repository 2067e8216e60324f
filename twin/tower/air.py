"""Moist air: saturation, humidity ratio, wet bulb, enthalpy and density. Pure functions of arrays.

Temperatures are in degC, pressures in kPa, enthalpies in J per kg of dry air, humidity ratios in kg/kg.

Source: ASHRAE Handbook Fundamentals 2017, chapter 1 (saturation by Hyland & Wexler 1983, equations 5 and 6; wet bulb by
equations 33 and 35).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

CP_DRY, CP_VAPOUR, CP_WATER, LATENT = 1006.0, 1860.0, 4186.0, 2.501e6
"""J/(kg K) of dry air, vapour and water; J/kg of evaporation at 0 degC."""
MOLAR_RATIO = 0.621945
GAS_DRY = 0.287042
"""kJ/(kg K)."""
SEA_LEVEL_KPA = 101.325
"""Standard pressure at sea level (ibid., equation 3 at height 0)."""

_WATER = (-5.8002206e3, 1.3914993, -4.8640239e-2, 4.1764768e-5, -1.4452093e-8, 6.5459673)
_ICE = (-5.6745359e3, 6.3925247, -9.677843e-3, 6.2215701e-7, 2.0747825e-9, -9.484024e-13, 4.1635019)


def saturation_pressure(celsius: ArrayLike) -> Array:
    """Return the pressure of saturated vapour over water, below 0 degC over ice, kPa."""
    kelvin = np.asarray(celsius, dtype=np.float64) + 273.15
    a, b, c, d, e, f = _WATER
    water = a / kelvin + b + kelvin * (c + kelvin * (d + kelvin * e)) + f * np.log(kelvin)
    a, b, c, d, e, g, f = _ICE
    ice = a / kelvin + b + kelvin * (c + kelvin * (d + kelvin * (e + kelvin * g))) + f * np.log(kelvin)
    return np.asarray(np.exp(np.where(kelvin >= 273.15, water, ice)) * 1.0e-3)


def humidity_ratio(vapour_kPa: ArrayLike, pressure_kPa: ArrayLike) -> Array:
    """Return the humidity ratio of air whose vapour has the given pressure."""
    vapour = np.asarray(vapour_kPa, dtype=np.float64)
    return np.asarray(MOLAR_RATIO * vapour / (np.asarray(pressure_kPa) - vapour))


def saturated_ratio(celsius: ArrayLike, pressure_kPa: ArrayLike) -> Array:
    """Return the humidity ratio of saturated air."""
    return humidity_ratio(saturation_pressure(celsius), pressure_kPa)


def enthalpy(celsius: ArrayLike, ratio: ArrayLike) -> Array:
    """Return the enthalpy of moist air."""
    t, w = np.asarray(celsius, dtype=np.float64), np.asarray(ratio, dtype=np.float64)
    return np.asarray(CP_DRY * t + w * (LATENT + CP_VAPOUR * t))


def saturated_enthalpy(celsius: ArrayLike, pressure_kPa: ArrayLike) -> Array:
    """Return the enthalpy of saturated air."""
    return enthalpy(celsius, saturated_ratio(celsius, pressure_kPa))


def ratio_from_wet_bulb(dry_C: ArrayLike, wet_C: ArrayLike, pressure_kPa: ArrayLike) -> Array:
    """Return the humidity ratio of air by its dry and wet bulb; negative where the two contradict each other."""
    dry, wet = np.asarray(dry_C, dtype=np.float64), np.asarray(wet_C, dtype=np.float64)
    saturated = saturated_ratio(wet, pressure_kPa)
    over_water = ((2501.0 - 2.326 * wet) * saturated - 1.006 * (dry - wet)) / (2501.0 + 1.86 * dry - 4.186 * wet)
    over_ice = ((2830.0 - 0.24 * wet) * saturated - 1.006 * (dry - wet)) / (2830.0 + 1.86 * dry - 2.1 * wet)
    return np.asarray(np.where(wet >= 0.0, over_water, over_ice))


def relative_humidity(dry_C: ArrayLike, wet_C: ArrayLike, pressure_kPa: ArrayLike) -> Array:
    """Return the relative humidity, 0 to 1, of air by its dry and wet bulb."""
    ratio = ratio_from_wet_bulb(dry_C, wet_C, pressure_kPa)
    vapour = np.asarray(pressure_kPa) * ratio / (MOLAR_RATIO + ratio)
    return np.asarray(vapour / saturation_pressure(dry_C))


def wet_bulb(dry_C: ArrayLike, humidity: ArrayLike, pressure_kPa: ArrayLike) -> Array:
    """Return the wet bulb (n,) of air, degC, by its dry bulb and relative humidity, 0 to 1: by bisection, to 1e-6 K."""
    dry, share, pressure = np.broadcast_arrays(
        np.asarray(dry_C, dtype=np.float64), np.asarray(humidity, dtype=np.float64), np.asarray(pressure_kPa)
    )
    wanted = humidity_ratio(np.clip(share, 0.0, 1.0) * saturation_pressure(dry), pressure)
    low, high = dry - 60.0, dry.copy()
    for _ in range(27):
        middle = 0.5 * (low + high)
        above = ratio_from_wet_bulb(dry, middle, pressure) > wanted
        high, low = np.where(above, middle, high), np.where(above, low, middle)
    return np.asarray(0.5 * (low + high))


def density(dry_C: ArrayLike, ratio: ArrayLike, pressure_kPa: ArrayLike) -> Array:
    """Return the density of moist air, kg/m3."""
    w = np.asarray(ratio, dtype=np.float64)
    kelvin = np.asarray(dry_C, dtype=np.float64) + 273.15
    return np.asarray(np.asarray(pressure_kPa) * (1.0 + w) / (GAS_DRY * kelvin * (1.0 + 1.607858 * w)))
