"""Merkel's integral, K a V/L = integral of c_p dT/(h_s - h_a), by Gauss-Legendre quadrature: a check of the
effectiveness form.

Source: Merkel, VDI Forschungsarbeiten 275 (1925); Baker & Shryock, J. Heat Transfer 83 (1961) 339.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from twin.tower.air import CP_WATER, Array, ratio_from_wet_bulb, saturated_enthalpy
from twin.tower.air import enthalpy as moist_enthalpy

ORDER = 16
"""Order of the quadrature: beyond 12 the fifth digit stays, also for approaches of 1 K."""


def merkel_number(
    hot_C: ArrayLike, cold_C: ArrayLike, air_in: ArrayLike, loading: ArrayLike, pressure_kPa: ArrayLike
) -> Array:
    """Return the Merkel number of counter-flow.

    Parameters
    ----------
    hot_C, cold_C
        Water in and out.
    air_in
        Enthalpy of the entering air, J/kg.
    loading
        Water over air, kg/kg.

    The number is infinite where the operating line meets saturation.
    """
    hot, cold, h_in, ratio = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (hot_C, cold_C, air_in, loading))
    )
    x, w = np.polynomial.legendre.leggauss(ORDER)
    share = 0.5 * (x + 1.0)
    t = cold[..., None] + share * (hot - cold)[..., None]
    air = h_in[..., None] + ratio[..., None] * CP_WATER * (t - cold[..., None])
    gap = saturated_enthalpy(t, np.asarray(pressure_kPa)[..., None] if np.ndim(pressure_kPa) else pressure_kPa) - air
    with np.errstate(divide="ignore"):
        total = (hot - cold) * np.sum(0.5 * w * CP_WATER / np.maximum(gap, 0.0), axis=-1)
    return np.asarray(np.where((gap > 0.0).all(axis=-1), total, np.inf))


def entering_enthalpy(dry_C: ArrayLike, wet_C: ArrayLike, pressure_kPa: ArrayLike) -> Array:
    """Return the enthalpy of air by its dry and wet bulb, J/kg."""
    return moist_enthalpy(dry_C, ratio_from_wet_bulb(dry_C, wet_C, pressure_kPa))
