"""Physics of the virtual station, compiled: moist air, Poppe's method, cell, plant.

The names below are the package's interface; they are loaded on first use. `cell`, `compiled` and `plant` are
public modules.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.virtual.tower.physics.cell import CELL, S_BLOCKAGE, S_FILL, S_PITCH, S_SLIP, S_UNIFORMITY, STATE
    from drivers.virtual.tower.physics.moist_air import dry_air_density, humidities, ratios, wet_bulb, wet_bulbs
    from drivers.virtual.tower.physics.plant import HIDDEN, OF_CELL, OF_STATION


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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("cell", "compiled", "plant"),
        "cell": ("CELL", "STATE", "S_BLOCKAGE", "S_FILL", "S_PITCH", "S_SLIP", "S_UNIFORMITY"),
        "moist_air": ("dry_air_density", "humidities", "ratios", "wet_bulb", "wet_bulbs"),
        "plant": ("HIDDEN", "OF_CELL", "OF_STATION"),
    },
)
