"""Random operation of a rig over some hours: load, pump, fan and room."""

from __future__ import annotations

import numpy as np

from twin.calibrators.hiera_unet.data.series import STEP_S
from twin.first_order_lag import recursion
from twin.network import Array, Network

KINDS = ("battle", "steps", "busy", "ramps", "constant", "cycles")
SHARES = (0.28, 0.22, 0.16, 0.12, 0.14, 0.08)
DWELL_S = {
    "battle": (300.0, 3600.0),
    "steps": (1200.0, 7200.0),
    "busy": (90.0, 1200.0),
    "ramps": (900.0, 3600.0),
    "constant": (1e9, 2e9),
    "cycles": (600.0, 1800.0),
}
COOLING_DWELL_S = (1800.0, 10800.0)
LOAD_SHARE = (0.4, 1.3)
"""Range of the load, as shares of the nominal power."""
SPEED_PCT = {"pump": (50.0, 100.0), "fan": (35.0, 100.0)}
STILL_SHARE = 0.35
"""Probability that pump and fan stay constant."""
SLOW_ROOM_S, SLOW_ROOM_K, DRAUGHT_S, DRAUGHT_K = 2400.0, 0.3, 45.0, 0.08
DAILY_ROOM_K = 1.5


def drive(
    network: Network, rng: np.random.Generator, n: int, hour: float, *, thorough: bool = False, power: float = 1.0
) -> Array:
    """Return inputs (n, c) of n steps, beginning at `hour` o'clock.

    Args:
        thorough: every input varies over its range, as commissioning requires.
        power: usual load of the rig as a share of the nominal one.
    """
    kind = "steps" if thorough else str(rng.choice(KINDS, p=SHARES))
    still = not thorough and bool(rng.uniform() < STILL_SHARE)
    columns = []
    for column, spec in network.inputs.items():
        if column.endswith("_W"):
            low, high = (share * power * spec.nominal for share in LOAD_SHARE)
            courses = course(rng, n, low, min(high, spec.upper), *DWELL_S[kind], ramps=kind == "ramps")
            if kind == "cycles":
                courses *= course(rng, n, 0.0, 1.0, 900.0, 3600.0) > 0.3
        elif column.endswith("_pct"):
            low, high = next((v for k, v in SPEED_PCT.items() if column.startswith(k)), (40.0, 100.0))
            dwell = (2e9, 3e9) if still else (1200.0, 3600.0) if thorough else COOLING_DWELL_S
            courses = course(rng, n, low, min(high, spec.upper), *dwell)
        elif column.endswith("_C"):
            courses = spec.nominal + rng.normal(0.0, 2.5) + room(rng, n, hour)
        else:
            courses = np.full(n, spec.nominal)
        columns.append(np.clip(courses, spec.lower, spec.upper))
    return np.column_stack(columns)


def course(
    rng: np.random.Generator,
    n: int,
    low: float,
    high: float,
    shortest_s: float,
    longest_s: float,
    *,
    ramps: bool = False,
) -> Array:
    """Return levels (n,) that hold for log-uniform times, or straight lines between them."""
    edges, at = [0.0], 0.0
    while at < n:
        at += float(np.exp(rng.uniform(np.log(shortest_s), np.log(longest_s)))) / STEP_S
        edges.append(at)
    levels = rng.uniform(low, high, len(edges))
    steps = np.arange(n, dtype=np.float64)
    if ramps:
        return np.interp(steps, edges, levels)
    held: Array = levels[np.searchsorted(edges, steps, side="right") - 1]
    return held


def room(rng: np.random.Generator, n: int, hour: float) -> Array:
    """Return the variation of a room (n,), K: the day's, a slow random one and draughts."""
    time = np.arange(n) * STEP_S / 3600.0
    daily = rng.uniform(0.0, DAILY_ROOM_K) * np.cos(2.0 * np.pi * (hour + time - 15.5) / 24.0)
    slow = wander(rng, n, SLOW_ROOM_K * rng.uniform(0.3, 2.0), SLOW_ROOM_S)
    swing: Array = daily + slow + wander(rng, n, DRAUGHT_K, DRAUGHT_S)
    return swing


def wander(rng: np.random.Generator, n: int, sd: float, constant_s: float) -> Array:
    """Return an Ornstein-Uhlenbeck course (n,)."""
    keep = float(np.exp(-STEP_S / constant_s))
    kicks = rng.standard_normal(n) * sd * np.sqrt(1.0 - keep**2)
    kicks[0] = rng.standard_normal() * sd
    return recursion(kicks, keep)
