"""Roles of points: the function of a point on the rig, independent of its name there."""

from __future__ import annotations

import difflib

HEATER, FAN, ROOM = "heater_power", "fan_speed", "T_ambient"
"""Roles that the thermal restore uses: it drives the first two, and cannot restore the third."""
ROLES: tuple[str, ...] = (
    HEATER,
    "pump_speed",
    FAN,
    "flow",
    ROOM,
    "T_heater",
    *(f"T_pm{number}" for number in range(1, 7)),
    "T_radiator",
    "T_tank",
)


def nearest_role(role: str, unit: str) -> str:
    """Return the known role that is closest to `role`; a temperature's only where `unit` is degC or K."""
    warm = unit in ("degC", "K")
    fitting = {known.lower(): known for known in ROLES if known.startswith("T_") == warm}
    return fitting[difflib.get_close_matches(role.lower(), fitting, n=1, cutoff=0.0)[0]]
