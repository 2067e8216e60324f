"""FMU in the place of the virtual rig's plant.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.fmu.plant import FmuPlant
    from drivers.virtual.fmu.ports import FmuPlantError, fmu_ports

_HOME = {
    "FmuPlant": "drivers.virtual.fmu.plant",
    "FmuPlantError": "drivers.virtual.fmu.ports",
    "fmu_ports": "drivers.virtual.fmu.ports",
}

__all__ = [
    "FmuPlant",
    "FmuPlantError",
    "fmu_ports",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
