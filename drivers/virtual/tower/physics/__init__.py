"""Physics of the virtual station, compiled: moist air, Poppe's method, cell, plant.

The names below are the package's interface; they are loaded on first use. `cell`, `compiled` and `plant` are
public modules.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.tower.physics.cell import CELL, S_BLOCKAGE, S_FILL, S_PITCH, S_SLIP, S_UNIFORMITY, STATE
    from drivers.virtual.tower.physics.moist_air import dry_air_density, humidities, ratios, wet_bulb, wet_bulbs
    from drivers.virtual.tower.physics.plant import HIDDEN, OF_CELL, OF_STATION

_MODULES = {
    "cell": (
        "CELL",
        "STATE",
        "S_BLOCKAGE",
        "S_FILL",
        "S_PITCH",
        "S_SLIP",
        "S_UNIFORMITY",
    ),
    "moist_air": (
        "dry_air_density",
        "humidities",
        "ratios",
        "wet_bulb",
        "wet_bulbs",
    ),
    "plant": (
        "HIDDEN",
        "OF_CELL",
        "OF_STATION",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}
_PUBLIC_MODULES = ("cell", "compiled", "plant")

__all__ = [
    "CELL",
    "HIDDEN",
    "OF_CELL",
    "OF_STATION",
    "STATE",
    "S_BLOCKAGE",
    "S_FILL",
    "S_PITCH",
    "S_SLIP",
    "S_UNIFORMITY",
    "cell",
    "compiled",
    "dry_air_density",
    "humidities",
    "plant",
    "ratios",
    "wet_bulb",
    "wet_bulbs",
]


def __getattr__(name: str) -> Any:
    """Load a public module, or a public name from its module, on first use."""
    if name in _PUBLIC_MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
