"""Outlet and fan power by the commissioned twin, minute by minute: the reference of the channels' residuals."""

from __future__ import annotations

import numpy as np

from twin.tower.air import Array
from twin.tower.cell import solve_cell
from twin.tower.minutes import Minutes, first_order_lag
from twin.tower.model import NAMES, SLOW, CellModel

ANY_KAPPA = -1.3
"""Exponent of the air in the fan's power; without a deviation it has no effect."""


def commissioned_outlet(model: CellModel, minutes: Minutes) -> Array:
    """Return the outlet by the clean cell, degC (n,), NaN where the inputs are unknown."""
    rows = np.flatnonzero(minutes.known)
    u = minutes.operation.inputs.take(rows)
    out = solve_cell(u, model.design).t_out
    clean = np.full(len(minutes.time_s), np.nan)
    clean[rows] = out + minutes.operation.bypass[rows] * (u.t_in - out)
    return first_order_lag(clean, minutes.known)


def commissioned_log_power(model: CellModel, minutes: Minutes) -> Array:
    """Return the logarithm of the clean cell's fan power, kW (n,), NaN where the inputs are unknown."""
    rows = np.flatnonzero(minutes.known)
    found = np.full(len(minutes.time_s), np.nan)
    neutral = np.zeros(len(NAMES))
    neutral[NAMES.index("kappa")] = ANY_KAPPA
    found[rows] = model.log_power(minutes.operation.take(rows), np.zeros((len(rows), len(SLOW))), neutral)
    return found
