"""Effects put on the outlet readings of a made cell, by formulas that the twin does not share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.twin.tower.made_cell import Made, made_cell


def weathered(days: float, seed: int) -> Made:
    """A made cell whose wind turns and whose neighbours start and stop."""
    made = made_cell(days, seed=seed)
    rng = np.random.default_rng(seed + 100)
    n, hours = len(made.time_s), np.arange(int(days * 24) + 2)
    minute = np.arange(n) / 60.0
    wind = np.interp(minute, hours, np.abs(3.5 + rng.normal(0, 1.5, len(hours))))
    turning = np.interp(minute, hours, np.cumsum(rng.normal(0, 35.0, len(hours))) + 200.0) % 360.0
    neighbours = 70.0 * (np.interp(minute, hours[::6], rng.random(len(hours[::6]))) > 0.5)
    changed = {"wind_m_s": wind, "wind_deg": turning, "neighbours_speed_pct": neighbours}
    return replace(made, columns={**made.columns, **changed})


def with_recirculation(made: Made, per_5_m_s: float, from_deg: float) -> Made:
    """The cell with exhaust that the wind from one direction brings back: half of the wet bulb's rise at the outlet."""
    c = made.columns
    blow = np.maximum(np.cos(np.radians(c["wind_deg"] - from_deg)), 0.0) * c["wind_m_s"] / 5.0
    rise = 0.5 * per_5_m_s * blow * 0.7 * (c["t_in_C"] - c["wet_C"])
    return replace(made, columns={**c, "t_out_C": c["t_out_C"] + rise})
