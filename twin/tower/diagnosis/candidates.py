"""Candidate effects of a tower cell: mechanism, driver and form, with the prior of each.

| prior | value |
|---|---|
| an effect; each further one | `FAULT` each |
| class (mechanism and driver) | `FREE` for the free columns together, uniform over the others |
| form (direction, threshold, hour; column and path of a free column) | uniform within its class |
| onset | one half "all along", else uniform over the grid |
| cells | one half "every recorded cell", else uniform over the cells |
| size | Gaussian about 0, standard deviation by class |
"""

from __future__ import annotations

import zoneinfo
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from twin.tower.air import Array
from twin.tower.effects import CellEffect

FAULT = 0.05
FREE = 1e-3
"""Share of the free columns in the prior of an effect: some hundred pairs of reading and column hardly ever have a
physical link, and what has one is a class of its own."""
DIRECTIONS = tuple(float(d) for d in range(0, 360, 10))
THRESHOLDS = (0.6, 0.7, 0.8, 0.9, 1.0, 1.1)
"""Flows, share of design, below which nozzles may starve beyond the law of the clean cell."""
FEWEST_VALUES = 0.5
"""Share of minutes in which a column must be known to drive anything."""
FOLLOWS = "follows"
ENDOGENOUS = (
    "t_out_C",
    "basin_C",
    "supply_C",
    "return_C",
    "check",
    "disturbed",
    "regime",
    "closure_K",
    "in_service",
    "fan_fault",
    "wind_deg",
    "level_pct",
    "fan_speed_pct",
    "fan_command_pct",
    "m_w_kg_s",
    "wet_C",
    "wet_rh_C",
    "t_in_C",
    "header_kPa",
    "riser_valve_pct",
    "fan_power_kW",
    "pump_kW",
    "makeup_kg_s",
    "blowdown_kg_s",
)
"""Columns that drive nothing free: those that the outlet itself moves, marks of the alignment, an angle, whose values
have no order, and the cell's operating point with what follows from it, powers and evaporation: an error that follows
these is the twin's own (`evidence.structural_error`)."""
FREE_SD = {"outlet": 0.5, "inlet": 0.5, "wet_bulb": 0.5, "water": 0.05}
"""Readings that may follow a column, and the standard deviation of the size for the column's spread, K or 1."""
LEAST_SPREAD = 1e-9
"""Spread of a column below which it stands still."""
DECOYS = {"decoy_wind": "wind_m_s", "decoy_air": "dry_C"}
"""Decoys by the column whose spectrum each has: a search that prefers one is a search that chance can win."""


@dataclass(frozen=True)
class EffectClass:
    """A class of effects: the forms that compete within it, and the prior of the size of each.

    Attributes
    ----------
    size_sd
        Standard deviation of each form's size (m,).
    sign
        1 or -1 where physics allows one sign only, else 0.
    says
        Meaning of a size.
    """

    name: str
    says: str
    forms: tuple[CellEffect, ...]
    size_sd: Array
    sign: int = 1


def candidates(columns: Mapping[str, Array], time_s: Array, timezone: str | None) -> tuple[EffectClass, ...]:
    """Return the classes whose drivers the columns hold, the readings that follow a column last.

    Parameters
    ----------
    columns
        Of the cell's aligned record, decoys among them.
    timezone
        Of the station, for the sun; None tries every hour of noon.
    """
    found: list[EffectClass] = []

    def add(name: str, says: str, forms: Sequence[CellEffect], sd: float, sign: int = 1) -> None:
        found.append(EffectClass(name, says, tuple(forms), np.full(len(forms), sd), sign))

    share = "share of the exhaust that comes back"
    if usable(columns, "wind_m_s"):
        if usable(columns, "wind_deg"):
            forms = [CellEffect("recirculation", "exhaust", "wind_direction", d) for d in DIRECTIONS]
            add("recirculation with wind from one direction", f"{share}, at 5 m/s from there", forms, 0.1)
        forms = [CellEffect("recirculation", "exhaust", "wind_speed")]
        add("recirculation with wind from anywhere", f"{share}, at 5 m/s", forms, 0.1)
    if usable(columns, "neighbours_speed_pct"):
        forms = [CellEffect("neighbour", "exhaust", "neighbours_speed")]
        add("plume of the neighbours", f"{share} with their fans at full speed", forms, 0.15)
    forms = [CellEffect("bypass_leak", "past_fill", "always")]
    add("water that leaks past the fill", "share of the water", forms, 0.1)
    hours = noons(timezone, time_s)
    add("sun on the water", "K under a sun overhead", [CellEffect("solar", "outlet", "solar", h) for h in hours], 0.5)
    add(
        "sun on the wet bulb's thermometer",
        "K under a sun overhead",
        [CellEffect("solar", "wet_bulb", "solar", h) for h in hours],
        0.5,
        -1,
    )
    if usable(columns, "m_w_kg_s"):
        forms = [CellEffect("underwetting", "wetted", "low_flow", low) for low in THRESHOLDS]
        add("loss of wetting below a flow", "share of the plan that dries for a share of the flow", forms, 0.5)
    free = _followers(columns)
    if free:
        sd = np.array([FREE_SD[one.path] for one in free])
        found.append(EffectClass("reading that follows a column", "K or share for its spread", free, sd, 0))
    return tuple(found)


def _followers(columns: Mapping[str, Array]) -> tuple[CellEffect, ...]:
    """Return the readings that follow a column, each reading with each column."""
    scaled = []
    for name in columns:
        if name in ENDOGENOUS or not usable(columns, name):
            continue
        low, middle, high = np.nanquantile(columns[name], [0.05, 0.5, 0.95])
        if high - low > LEAST_SPREAD:
            scaled.append((name, float(middle), float(high - low)))
    return tuple(
        CellEffect(FOLLOWS, path, "column", column=n, centre=c, spread=s) for path in FREE_SD for n, c, s in scaled
    )


def usable(columns: Mapping[str, Array], name: str) -> bool:
    """Return True if a column is known in enough minutes to drive an effect."""
    return name in columns and float(np.isfinite(columns[name]).mean()) >= FEWEST_VALUES


def noons(timezone: str | None, time_s: Array) -> tuple[float, ...]:
    """Return the hours UTC at which the sun may stand highest: within an hour of the zone's noon, or all of a day."""
    try:
        zone = zoneinfo.ZoneInfo(timezone or "")
        offset = zone.utcoffset(datetime.fromtimestamp(float(time_s[0]), zone).replace(tzinfo=None))
        saving = zone.dst(datetime.fromtimestamp(float(time_s[0]), zone).replace(tzinfo=None))
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError):
        return tuple(float(h) for h in range(24))
    hours = ((offset.total_seconds() if offset else 0.0) - (saving.total_seconds() if saving else 0.0)) / 3600.0
    return tuple(float((12.0 - hours + shift) % 24.0) for shift in (-1.0, 0.0, 1.0))


def decoys(columns: Mapping[str, Array], seed: int) -> dict[str, Array]:
    """Return the decoys of the columns that are usable."""
    return {
        name: surrogate(columns[of], seed + k) for k, (name, of) in enumerate(DECOYS.items()) if usable(columns, of)
    }


def surrogate(values: Array, seed: int) -> Array:
    """Return a decoy: a series of the same spectrum with random phases (n,). Source: Theiler et al., Physica D 58
    (1992) 77."""
    there = np.isfinite(values)
    filled = np.interp(np.arange(len(values)), np.flatnonzero(there), values[there])
    spectrum = np.fft.rfft(filled - filled.mean())
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(spectrum))
    return np.asarray(np.fft.irfft(np.abs(spectrum) * np.exp(1j * phases), len(values)) + filled.mean())


def onset_grid(start_s: float, end_s: float) -> list[float]:
    """Return times at which an effect may have begun, inside the record: every four days, but 4 to 24 of them."""
    count = int(np.clip((end_s - start_s) // (4.0 * 86400.0), 4, 24))
    return [float(t) for t in np.linspace(start_s, end_s, count + 2)[1:-1]]
