"""Public part of a case: rig, length and load profile, drawn from a seed of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.profile import Profile
from twin import Array

KINDS = ("case", "healthy", "double", "again", "later")
"""Kinds of records: single case, healthy, two effects of the catalogue; first and later records of a twin under
repeated diagnosis.
"""
LOADS = ("battle", "steps", "busy", "constant fan and pump")
UNITS = (1, 2, 3, 4)
"""Specimens of the rig: each has its own sensor offsets and is commissioned once."""
COLUMNS = ("heater_power_W", "pump_speed_pct", "fan_speed_pct")
_FURTHER = 1_000_003


@dataclass(frozen=True, slots=True)
class Setting:
    """Public part of a case: number, seed of weather and noise, specimen, kind of load and length in h."""

    number: int
    seed: int
    unit: int
    load: str
    hours: float


def setting(number: int, seed: int, hours: float, kind: str = "case") -> Setting:
    """Return the public part of record `number` of a kind."""
    rng = np.random.default_rng([seed + _FURTHER * KINDS.index(kind), number, 0])
    unit = int(rng.choice(UNITS))
    load = LOADS[int(rng.choice(len(LOADS), p=(0.3, 0.35, 0.2, 0.15)))]
    return Setting(number, int(rng.integers(1_000, 1_000_000)), unit, load, hours)


def profile(case: Setting) -> Profile:
    """Return the load profile of a case: constant set-points between changes, ending at its length."""
    rng = np.random.default_rng([case.seed, 4])
    end = case.hours * 3600.0
    power = {"battle": (620.0, 880.0), "busy": (350.0, 850.0)}.get(case.load, (450.0, 850.0))
    dwell = {"battle": (300.0, 3600.0), "busy": (120.0, 1500.0)}.get(case.load, (1200.0, 7200.0))
    heater = _course(rng, end, *power, 5.0, *dwell)
    if case.load == "constant fan and pump":
        pump, fan = np.array([[0.0, 100.0]]), np.array([[0.0, 80.0]])
    elif case.load == "battle":
        pump = _course(rng, end, 80.0, 100.0, 5.0, 2400.0, 10800.0)
        fan = _course(rng, end, 70.0, 100.0, 5.0, 2400.0, 10800.0)
    else:
        pump = _course(rng, end, 65.0, 100.0, 5.0, 3600.0, 14400.0)
        fan = _course(rng, end, 55.0, 100.0, 5.0, 3600.0, 14400.0)
    times = np.unique(np.concatenate([heater[:, 0], pump[:, 0], fan[:, 0], [end]]))
    values = np.column_stack([c[np.searchsorted(c[:, 0], times, side="right") - 1, 1] for c in (heater, pump, fan)])
    return Profile(f"case_{case.number}", times, COLUMNS, values)


def _course(
    rng: np.random.Generator, end: float, low: float, high: float, step: float, shortest: float, longest: float
) -> Array:
    """Return times, s, and levels (n, 2), in multiples of `step`."""
    times, t = [0.0], 0.0
    while (t := t + float(np.exp(rng.uniform(np.log(shortest), np.log(longest))))) < end - 60.0:
        times.append(float(round(t)))
    levels = np.round(rng.uniform(low, high, len(times)) / step) * step
    return np.column_stack([times, levels])


def profile_text(profile: Profile) -> str:
    """Return the profile as a CSV file for `hil run`."""
    rows = [",".join(f"{v:g}" for v in (t, *row)) for t, row in zip(profile.time_s, profile.values, strict=True)]
    return "\n".join([",".join(("time_s", *profile.columns)), *rows]) + "\n"
