"""A cell that the tests make: Merkel's integral by the trapezoidal rule with Magnus' formula, noise and slow
degradation.

Nothing here is shared with the twin: other psychrometrics, another solution, and errors that the twin does not have.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

M_W0, M_A0, ME0, EXPONENT, POWER, IDLE = 200.0, 170.0, 1.5, 0.6, 40.0, 1.2
PRESSURE = 99.0
START_S = 1.66e9 // 86400 * 86400


def saturated(t: Array) -> Array:
    """Pressure of saturated vapour by Magnus, kPa."""
    return 0.6112 * np.exp(17.62 * t / (243.12 + t))


def enthalpy(t: Array, w: Array) -> Array:
    return 1005.0 * t + w * (2.5009e6 + 1860.0 * t)


def ratio(vapour: Array) -> Array:
    return 0.62198 * vapour / (PRESSURE - vapour)


def vapour_of(dry: Array, wet: Array) -> Array:
    """Sprung's psychrometer equation."""
    return saturated(wet) - 6.62e-4 * PRESSURE * (dry - wet)


def outlet(t_in: Array, m_w: Array, m_a: Array, dry: Array, wet: Array, number: Array) -> Array:
    """Outlet by bisection on Merkel's integral in 24 trapezoids; a line that meets saturation counts as infinite."""
    h_in = enthalpy(dry, ratio(vapour_of(dry, wet)))
    low, high = wet + 0.02, t_in - 1e-4
    share = np.linspace(0.0, 1.0, 25)
    for _ in range(34):
        mid = 0.5 * (low + high)
        t = mid[:, None] + share * (t_in - mid)[:, None]
        gap = enthalpy(t, ratio(saturated(t))) - (h_in[:, None] + (m_w / m_a)[:, None] * 4186.0 * (t - mid[:, None]))
        f = np.where((gap > 0).all(axis=1), np.trapezoid(4186.0 / np.maximum(gap, 1.0), t, axis=1), np.inf)
        low, high = np.where(f > number, mid, low), np.where(f > number, high, mid)
    return 0.5 * (low + high)


@dataclass(frozen=True)
class Made:
    """Minutes of a made cell: aligned columns with the origin of their values, and the truth."""

    time_s: Array
    columns: dict[str, Array]
    origin: dict[str, NDArray[np.uint8]]
    truth: dict[str, Array] = field(default_factory=dict)


def made_cell(
    days: float,
    seed: int = 0,
    *,
    fill: tuple[float, float] = (0.88, 0.86),
    air: float = 0.93,
    bias: float = 0.3,
    step: tuple[float, float] | None = None,
    test_days: tuple[int, ...] = (2, 5),
    error_K: float = 0.05,
    hot: float = 18.0,
) -> Made:
    """Minutes of a cell with a fill that goes from the first to the second value.

    `step`: day and size K of a step of the outlet thermometer. `test_days`: with a step test of fan and flow.
    `error_K`: size of an error of the twin's structure that follows the wet bulb.
    """
    rng = np.random.default_rng(seed)
    n = int(days * 1440)
    coarse = np.arange(0, n + 10, 10)
    day = coarse / 1440.0
    wet = (
        hot
        + 3.0 * np.sin(2 * np.pi * (day - 0.35))
        + np.interp(day, np.arange(int(days) + 2), rng.normal(0, 2, int(days) + 2))
    )
    dry = wet + 4.0 + 2.5 * np.sin(2 * np.pi * (day - 0.35))
    speed = 0.75 + 0.15 * np.sin(2 * np.pi * (day - 0.5))
    flow = np.full(len(day), M_W0 * 0.98)
    for at in test_days:
        for k, (v, m) in enumerate(
            ((0.5, 1.0), (0.8, 1.0), (1.0, 1.0), (1.0, 0.72), (0.6, 0.72), (0.8, 0.72), (0.8, 1.0))
        ):
            rows = (day >= at + 0.4 + k * 75 / 1440) & (day < at + 0.4 + (k + 1) * 75 / 1440)
            speed[rows], flow[rows] = v, M_W0 * m
    fill_now = np.interp(day, [0, days], fill)
    rho = (PRESSURE / (0.287 * (dry + 273.15))) / 1.13
    m_a = M_A0 * speed * rho * air
    fall = 6.0 * M_W0 / flow * (1 + 0.15 * np.sin(2 * np.pi * (day - 0.6)))
    number = fill_now * ME0 * (flow / m_a / (M_W0 / M_A0)) ** -EXPONENT
    low, high = wet + 1.0, wet + 60.0
    for _ in range(24):
        t_in = 0.5 * (low + high)
        enough = t_in - outlet(t_in, flow, m_a, dry, wet, number) > fall
        low, high = np.where(enough, low, t_in), np.where(enough, t_in, high)
    out = outlet(t_in, flow, m_a, dry, wet, number) + error_K * (18.0 - wet) / 5.0
    minute = np.arange(n)

    def fine(v: Array) -> Array:
        return np.interp(minute, coarse, v)

    t_out = fine(out)
    reading = t_out + bias + rng.normal(0, 0.04, n)
    if step is not None:
        reading = reading + step[1] * (minute >= step[0] * 1440)
    power = IDLE + POWER * fine(speed) ** 3 * fine(rho) * (1 + 1.5 * (air - 1.0))
    sampled = (minute % 3 == 0).astype(np.uint8) + 2 * (minute % 3 != 0).astype(np.uint8)
    columns = {
        "t_in_C": fine(t_in) + rng.normal(0, 0.03, n),
        "t_out_C": reading,
        "m_w_kg_s": fine(flow) * (1 + rng.normal(0, 0.004, n)),
        "fan_speed_pct": 100 * fine(speed),
        "fan_command_pct": 100 * fine(speed),
        "fan_power_kW": power * (1 + rng.normal(0, 0.01, n)),
        "dry_C": fine(dry),
        "wet_C": fine(wet) + rng.normal(0, 0.05, n),
        "wet_rh_C": fine(wet),
        "pressure_kPa": np.full(n, PRESSURE),
        "wind_m_s": 3.0 + rng.normal(0, 0.3, n),
        "wind_deg": np.full(n, 200.0),
        "neighbours_speed_pct": np.full(n, 70.0),
        "bypass_pct": np.zeros(n),
        "regime": np.full(n, 3.0),
        "check": np.zeros(n),
        "in_service": np.ones(n),
        "basin_C": np.interp(minute - 15, coarse, out) + rng.normal(0, 0.03, n),
        "makeup_kg_s": np.zeros(n),
    }
    truth = {"t_out": t_out, "fill": fine(fill_now), "air": np.full(n, air), "bias": np.full(n, bias)}
    return Made(START_S + 60.0 * minute, columns, dict.fromkeys(columns, sampled), truth)


def made_points(seed: int = 1) -> dict[str, Array]:
    """Clean test points: columns of a commissioning file."""
    rng = np.random.default_rng(seed)
    wet = rng.uniform(21, 25, 14)
    dry = wet + rng.uniform(3, 7, 14)
    speed = np.array([1.0] * 9 + [0.85, 0.7, 0.6, 0.5, 0.5])
    flow = M_W0 * np.array([1, 1, 1, 0.9, 0.9, 0.9, 1.1, 1.1, 1.1, 1, 1, 1, 1, 1.0])
    rho = (PRESSURE / (0.287 * (dry + 273.15))) / 1.13
    m_a = M_A0 * speed * rho
    t_in = wet + rng.uniform(9, 13, 14)
    out = outlet(t_in, flow, m_a, dry, wet, ME0 * (flow / m_a / (M_W0 / M_A0)) ** -EXPONENT)
    return {
        "water_inlet_C": t_in,
        "water_outlet_C": out + rng.normal(0, 0.03, 14),
        "entering_wet_bulb_C": wet,
        "dry_bulb_C": dry,
        "pressure_kPa": np.full(14, PRESSURE),
        "water_flow_kg_s": flow,
        "fan_speed_pct": 100 * speed,
        "fan_power_kW": IDLE + POWER * speed**3 * rho,
        "air_flow_kg_s": m_a * (1 + rng.normal(0, 0.01, 14)),
    }
