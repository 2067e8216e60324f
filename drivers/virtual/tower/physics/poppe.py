"""Poppe's method for counter-flow fill, compiled: heat and mass transfer with a Lewis factor and supersaturated air.

The three equations march with the water temperature, from the cold water at the bottom to the hot water at the top, by
Runge-Kutta. The Merkel number falls with the outlet temperature; where the operating line meets saturation it is
infinite, so that the search for the outlet is monotone. No table is needed: warm-started, a point takes some 8 us.

Sources: Kloppers & Kroeger, Int. J. Heat Mass Transfer 48 (2005) 765, equations of both branches; Bosnjakovic (1965),
Lewis factor.
"""

import numpy as np
from numba import njit

from drivers.virtual.tower.physics.moist_air import (
    CP_AIR,
    CP_VAPOUR,
    CP_WATER,
    LATENT,
    MOLAR,
    enthalpy,
    saturated_ratio,
    saturation,
)

STEPS = 4
"""Runge-Kutta steps: against 60 of them the outlet is off by less than 1e-3 K at nine points of ten, and by 0.03 K at
worst."""
LEAST_DRIVE = 1.0
"""Driving enthalpy, J/kg, at which the operating line counts as meeting saturation."""
TOLERANCE_K = 1e-4
SETTLED = 2e-5
"""Error of the evaporated share at which the air's ratio at the top is settled; a pinch magnifies it."""
LEWIS = 0.865 ** (2.0 / 3.0)
LEAST_RANGE_K = 0.02
"""Water less than this above the wet bulb leaves as it came."""


@njit
def slopes(
    tw: float, w: float, i: float, w_out: float, loading: float, p: float, t_guess: float
) -> tuple[float, float, float, float]:
    """Return dw/dTw, di/dTw, dMe/dTw and the air temperature; a dMe/dTw of infinity where there is no drive."""
    ps = saturation(tw)
    wsw = MOLAR * ps / (p - ps)
    iv = LATENT + CP_VAPOUR * tw
    isw = CP_AIR * tw + wsw * iv
    ta = (i - w * LATENT) / (CP_AIR + w * CP_VAPOUR)
    pa = saturation(ta)
    wsa = MOLAR * pa / (p - pa)
    wet = w > wsa
    if wet:
        # Magnus' slope of the saturation is close enough for Newton's method.
        step = rise = 0.0
        ta = max(t_guess, ta)
        for _ in range(2):
            pa = saturation(ta)
            wsa = MOLAR * pa / (p - pa)
            rise = wsa * p / (p - pa) * (4283.0 / (243.04 + ta) ** 2)
            miss = CP_AIR * ta + wsa * (LATENT + CP_VAPOUR * ta) + (w - wsa) * CP_WATER * ta - i
            step = -miss / (CP_AIR + rise * (LATENT + (CP_VAPOUR - CP_WATER) * ta) + w * CP_WATER)
            ta += step
        wsa += rise * step
    base = wsa if wet else w
    x = (wsw + 0.622) / (base + 0.622)
    lewis = LEWIS if abs(x - 1.0) < 1e-6 else LEWIS * (x - 1.0) / np.log(x)
    gap = wsw - base
    drive = isw - i
    if wet:
        liquid = (w - wsa) * CP_WATER * tw
        below = drive + (lewis - 1.0) * (drive - gap * iv + liquid) + (w - wsw) * CP_WATER * tw
    else:
        below = drive + (lewis - 1.0) * (drive - gap * iv) - gap * CP_WATER * tw
    if below < LEAST_DRIVE or drive < LEAST_DRIVE:
        return 0.0, 0.0, np.inf, ta
    flow = CP_WATER * (loading - (w_out - w))
    return flow * gap / below, flow * (1.0 + CP_WATER * tw * gap / below), CP_WATER / below, ta


@njit
def merkel_number(
    t_out: float, t_in: float, loading: float, t_air: float, w_air: float, p: float, w_out: float, steps: int = STEPS
) -> tuple[float, float, float]:
    """Return the Merkel number that brings the water from `t_in` to `t_out`, and the air's ratio and enthalpy at the
    top.

    `loading` is water over dry air at the top, `w_out` a guess of the air's ratio there. The number is infinite where
    the operating line meets saturation.
    """
    h = (t_in - t_out) / steps
    w, i, me, ta = w_air, enthalpy(t_air, w_air), 0.0, t_air
    for k in range(steps):
        t = t_out + k * h
        a1, b1, c1, ta = slopes(t, w, i, w_out, loading, p, ta)
        a2, b2, c2, ta = slopes(t + 0.5 * h, w + 0.5 * h * a1, i + 0.5 * h * b1, w_out, loading, p, ta)
        a3, b3, c3, ta = slopes(t + 0.5 * h, w + 0.5 * h * a2, i + 0.5 * h * b2, w_out, loading, p, ta)
        a4, b4, c4, ta = slopes(t + h, w + h * a3, i + h * b3, w_out, loading, p, ta)
        me += h / 6.0 * (c1 + 2.0 * c2 + 2.0 * c3 + c4)
        if not me < 1e6:
            return np.inf, w, i
        w += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        i += h / 6.0 * (b1 + 2.0 * b2 + 2.0 * b3 + b4)
    return me, w, i


@njit
def outlet(
    t_in: float,
    loading: float,
    t_air: float,
    w_air: float,
    p: float,
    t_wet: float,
    number: float,
    t_guess: float,
    w_guess: float,
) -> tuple[float, float, float]:
    """Return the water's outlet temperature for a Merkel number, and the air's ratio and enthalpy at the top.

    The search keeps a bracket from the entering wet bulb `t_wet` to the inlet. It takes secant steps on the logarithm
    of the Merkel number where both ends are finite, and halves the bracket otherwise.
    """
    i_air = enthalpy(t_air, w_air)
    if t_in - t_wet < LEAST_RANGE_K or number <= 0.0:
        return t_in, w_air, i_air
    low, high = t_wet, t_in
    x = min(max(t_guess, low + 1e-3 * (high - low)), high - 1e-3 * (high - low))
    w_out, i_out = w_guess, i_air
    x_before, f_before = np.nan, np.nan
    lenient = False
    for _ in range(80):
        me, w_new, i_new = merkel_number(x, t_in, loading, t_air, w_air, p, w_out)
        finite = me < 1e6
        if finite and abs(w_new - w_out) * loading > SETTLED:
            w_out, i_out = w_new, i_new
            continue
        if not finite and not lenient:
            # More evaporation flattens the operating line: what meets saturation even so does so at its own ratio.
            lenient, w_out = True, saturated_ratio(t_in, p)
            continue
        lenient = False
        f = np.log(max(me, 1e-12) / number) if finite else np.inf
        if finite:
            w_out, i_out = w_new, i_new
        if f > 0.0:
            low = x
        else:
            high = x
        step = np.nan
        if finite and np.isfinite(f_before) and f != f_before:
            step = x - f * (x - x_before) / (f - f_before)
        elif finite:
            # d(ln Me)/dT between the ends' behaviour: the number falls to nothing at the inlet.
            step = x + f * 0.7 * (t_in - x) * (x - t_wet) / (t_in - t_wet)
        x_before, f_before = x, f
        if not (low < step < high):
            step = 0.5 * (low + high)
        if finite:
            # What evaporates goes with the heat, so the next guess of the ratio settles at once.
            w_out = w_air + (w_out - w_air) * (t_in - step) / (t_in - x)
        if finite and (abs(step - x) < TOLERANCE_K or high - low < TOLERANCE_K):
            x = step
            break
        if high - low < 1e-7:
            break
        x = step
    return x, w_out, i_out
