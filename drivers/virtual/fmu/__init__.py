"""FMU in the place of the virtual rig's plant.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.virtual.fmu.plant import FmuPlant
    from drivers.virtual.fmu.ports import FmuPlantError, fmu_ports


__all__ = [
    "FmuPlant",
    "FmuPlantError",
    "fmu_ports",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "plant": ("FmuPlant",),
        "ports": ("FmuPlantError", "fmu_ports"),
    },
)
