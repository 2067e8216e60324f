"""Roles that a point may have: what it is on the rig, whatever it is called there."""

from __future__ import annotations

import difflib

HEATER, FAN, ROOM = "heater_power", "fan_speed", "T_ambient"
"""Those that something depends on: `hil resume` leads by the first two and leads nothing back to the third."""
ROLES: tuple[str, ...] = (
    HEATER, "pump_speed", FAN, "flow", ROOM, "T_heater", *(f"T_pm{number}" for number in range(1, 7)), "T_radiator",
    "T_tank",
)  # fmt: skip


def nearest_role(role: str, unit: str) -> str:
    """The known role that was most likely meant; a temperature's only where `unit` is one."""
    warm = unit in ("degC", "K")
    fitting = {known.lower(): known for known in ROLES if known.startswith("T_") == warm}
    return fitting[difflib.get_close_matches(role.lower(), fitting, n=1, cutoff=0.0)[0]]
