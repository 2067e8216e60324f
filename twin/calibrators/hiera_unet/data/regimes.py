"""Operating regimes of a rig, from its inputs alone by a deterministic state machine.

    0 unknown      a required input has not been read yet 1 rest         no heat, negligible flow 2 heat off     flow
    without heat 3 no flow      heat without flow 4 start-up     the first while after rest, heat off or no flow 5 load
    the load was stepped lately 6 cooling      pump or fan was stepped lately 7 steady       none of these

Every label depends on the present and the past only. The unit of an input, W or %, determines whether it is a load or
drives the cooling.
"""

from __future__ import annotations

import numpy as np

from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.network import Array, Network

COUNT = 8
UNKNOWN, REST, HEAT_OFF, NO_FLOW, STARTUP, LOAD, COOLING, STEADY = range(COUNT)
NAMES = ("unknown", "rest", "heat off", "no flow", "start-up", "load", "cooling", "steady")
OFF_SHARE = 0.03
"""Share of the nominal value below which an input counts as off."""
STEP_SHARE = 0.02
"""Share of the nominal value by which an input must have changed to count as stepped."""
LATELY_S = 300.0
STARTUP_S = 1200.0


def regimes(network: Network, inputs: Array) -> np.ndarray:
    """Return labels (n,) int8 of steps with inputs (n, c), NaN where missing."""
    columns = network.input_columns
    nominal = np.maximum(np.abs(network.nominal_inputs), 1e-9)
    loads = [j for j, c in enumerate(columns) if c.endswith("_W")]
    drives = [j for j, c in enumerate(columns) if c.endswith("_pct")]
    pumps = [j for j in drives if columns[j].startswith("pump")]
    share = _held(inputs) / nominal
    out = np.full(len(inputs), STEADY, dtype=np.int8)
    lately, start = int(LATELY_S / STEP_S), int(STARTUP_S / STEP_S)
    out[_stepped(share[:, drives], lately)] = COOLING
    out[_stepped(share[:, loads], lately)] = LOAD
    hot = (share[:, loads] > OFF_SHARE).any(axis=1) if loads else np.ones(len(inputs), dtype=bool)
    flowing = (share[:, pumps] > OFF_SHARE).all(axis=1) if pumps else np.ones(len(inputs), dtype=bool)
    running = np.asarray(hot & flowing)
    out[running & within(np.asarray(~running), start)] = STARTUP
    out[hot & ~flowing], out[~hot & flowing], out[~hot & ~flowing] = NO_FLOW, HEAT_OFF, REST
    needed = loads + drives
    out[np.isnan(share[:, needed]).any(axis=1)] = UNKNOWN
    return out


def within(event: np.ndarray, steps: int) -> np.ndarray:
    """Return True (n,) where an event happened at a step or in the `steps` before it."""
    since = since_last(event)
    found: np.ndarray = since <= steps
    return found


def since_last(event: np.ndarray) -> Array:
    """Return the steps (n,) since the last event, 0 at it, infinite before the first."""
    n = len(event)
    latest = np.maximum.accumulate(np.where(event, np.arange(n), -1))
    since: Array = np.where(latest >= 0, np.arange(n) - latest, np.inf)
    return since


def _stepped(share: Array, steps: int) -> np.ndarray:
    """Return True where any column changed by more than STEP_SHARE within half a minute, lately."""
    if not share.shape[1]:
        return np.zeros(len(share), dtype=bool)
    back = max(int(30.0 / STEP_S), 1)
    moved = np.zeros(share.shape, dtype=bool)
    moved[back:] = np.abs(share[back:] - share[:-back]) > STEP_SHARE
    return within(np.asarray(moved.any(axis=1)), steps)


def _held(inputs: Array) -> Array:
    good = np.isfinite(inputs)
    row = np.maximum.accumulate(np.where(good, np.arange(len(inputs))[:, None], -1), axis=0)
    held: Array = np.where(row >= 0, np.take_along_axis(inputs, np.maximum(row, 0), axis=0), np.nan)
    return held
