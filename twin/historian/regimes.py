"""Regimes of a cell, minute by minute: a deterministic state machine of command and response.

The eight regimes are a reading of the paper, which names the number only. A minute takes the first that holds:

| number | regime | holds where |
|---|---|---|
| 0 | off | no water flows over the fill |
| 7 | upset | a fan fault, a fan that does not follow its command, an event's disturbance, or flow or fan unknown |
| 5 | start_up | water has flowed for less than `START_UP_MIN` |
| 6 | bypass | the bypass valve is open |
| 4 | fan_transition | command or speed moved by more than `MOVED_PCT` within `SETTLING_MIN` |
| 1 | free_convection | the fan stands still |
| 2 | low_fan | speed up to `LOW_FAN_PCT` |
| 3 | high_fan | above |

Only minutes before count, so the regime of a minute never depends on what comes after it.
"""

from __future__ import annotations

import enum

import numpy as np
from numpy.typing import NDArray

from twin.historian.tags import Array

START_UP_MIN = 20
"""Water's way through header, fill and basin, and the outlet thermometer's settling."""
SETTLING_MIN = 10
"""A drive's ramp and the film's and the thermometer's delay; also two samples of a tag of five minutes."""
MOVED_PCT = 8.0
"""Change of speed beyond a controller's hunting."""
LOW_FAN_PCT = 55.0
STANDSTILL_PCT = 5.0
FOLLOWS_PCT = 15.0
"""Largest difference between speed and command of a drive that follows, once it has settled."""
BYPASS_PCT = 5.0
SHARE_FLOWING = 0.05
"""Share of the 95 % quantile of the flow: below it no water flows."""


class Regime(enum.IntEnum):
    """Regime of a cell in a minute."""

    OFF = 0
    FREE_CONVECTION = 1
    LOW_FAN = 2
    HIGH_FAN = 3
    FAN_TRANSITION = 4
    START_UP = 5
    BYPASS = 6
    UPSET = 7


def regimes(
    *,
    flow: Array,
    in_service: Array,
    command: Array,
    speed: Array,
    bypass: Array,
    fault: Array,
    disturbed: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Return the regime of each minute (n,).

    Parameters
    ----------
    flow
        Water flow, kg/s (n,); NaN where it is not known, as in all others.
    in_service
        1 where the cell is said to have water, else 0.
    command, speed
        Of the fan, %.
    bypass
        Valve position, %.
    fault
        1 where the fan is faulted.
    disturbed
        Minutes under an event's influence.
    """
    known = np.isfinite(flow)
    usual = float(np.quantile(flow[known], 0.95)) if known.any() else 0.0
    flowing = np.where(known, flow > SHARE_FLOWING * max(usual, 1e-9), in_service > 0.5)
    water_known = known | np.isfinite(in_service)
    off = water_known & ~flowing
    fan = np.where(np.isfinite(speed), speed, command)
    unknown = ~water_known | ~np.isfinite(fan)
    moving = _moved(command) | _moved(speed)
    apart = np.abs(np.nan_to_num(speed - command)) > FOLLOWS_PCT
    upset = unknown | (np.nan_to_num(fault) > 0.5) | (apart & ~moving) | disturbed
    chosen = np.select(
        [
            off,
            upset,
            _since(flowing & ~off) < START_UP_MIN,
            np.nan_to_num(bypass) > BYPASS_PCT,
            moving,
            fan < STANDSTILL_PCT,
            fan <= LOW_FAN_PCT,
        ],
        [
            Regime.OFF,
            Regime.UPSET,
            Regime.START_UP,
            Regime.BYPASS,
            Regime.FAN_TRANSITION,
            Regime.FREE_CONVECTION,
            Regime.LOW_FAN,
        ],
        Regime.HIGH_FAN,
    )
    return chosen.astype(np.uint8)


def start_ups(regime: NDArray[np.uint8], water_known: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the rows in which water began to flow (k,): the cell was off when its water was known before.

    A start within `START_UP_MIN` of the one before belongs to it.

    Parameters
    ----------
    regime
        Of each minute (n,).
    water_known
        Minutes in which flow or state is known (n,).
    """
    known = np.flatnonzero(water_known)
    off = regime[known] == Regime.OFF
    found: list[int] = []
    for row in known[1:][off[:-1] & ~off[1:]].tolist():
        if not found or row - found[-1] >= START_UP_MIN:
            found.append(row)
    return np.asarray(found, dtype=np.intp)


def _moved(percent: Array) -> NDArray[np.bool_]:
    """Return minutes within `SETTLING_MIN` after a change by more than `MOVED_PCT`."""
    n = len(percent)
    moved = np.zeros(n, dtype=bool)
    for lag in range(1, SETTLING_MIN + 1):
        if lag < n:
            moved[lag:] |= np.abs(np.nan_to_num(percent[lag:] - percent[:-lag])) > MOVED_PCT
    return moved


def _since(flowing: NDArray[np.bool_]) -> Array:
    """Return the minutes since water began to flow (n,); where it flows from the beginning it is taken as long ago."""
    n = len(flowing)
    index = np.arange(n)
    last_dry = np.maximum.accumulate(np.where(flowing, -1, index))
    return np.where(last_dry < 0, np.inf, (index - last_dry - 1).astype(np.float64))
