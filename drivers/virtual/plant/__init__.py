"""Plant of the virtual rig and its instruments.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.plant.ambient import Room
    from drivers.virtual.plant.effects import FORMS, EffectFileError, Form, PlantEffect, load_effects
    from drivers.virtual.plant.geometry import CHANNELS, MODULES, PLACES, Array, Cells, build_cells
    from drivers.virtual.plant.instruments import Instruments
    from drivers.virtual.plant.kernel import NOMINAL_FLOW_L_PER_MIN
    from drivers.virtual.plant.machine_code import may_cache
    from drivers.virtual.plant.plant import Plant
    from drivers.virtual.plant.simulated_plant import SimulatedPlant
    from drivers.virtual.plant.thermocouple_module import FRAME_IDS, OPEN_CIRCUIT, ThermocoupleModule

_HOME = {
    "Array": "drivers.virtual.plant.geometry",
    "CHANNELS": "drivers.virtual.plant.geometry",
    "Cells": "drivers.virtual.plant.geometry",
    "PlantEffect": "drivers.virtual.plant.effects",
    "EffectFileError": "drivers.virtual.plant.effects",
    "FORMS": "drivers.virtual.plant.effects",
    "FRAME_IDS": "drivers.virtual.plant.thermocouple_module",
    "Form": "drivers.virtual.plant.effects",
    "Instruments": "drivers.virtual.plant.instruments",
    "MODULES": "drivers.virtual.plant.geometry",
    "NOMINAL_FLOW_L_PER_MIN": "drivers.virtual.plant.kernel",
    "OPEN_CIRCUIT": "drivers.virtual.plant.thermocouple_module",
    "PLACES": "drivers.virtual.plant.geometry",
    "Plant": "drivers.virtual.plant.plant",
    "Room": "drivers.virtual.plant.ambient",
    "SimulatedPlant": "drivers.virtual.plant.simulated_plant",
    "ThermocoupleModule": "drivers.virtual.plant.thermocouple_module",
    "build_cells": "drivers.virtual.plant.geometry",
    "load_effects": "drivers.virtual.plant.effects",
    "may_cache": "drivers.virtual.plant.machine_code",
}

__all__ = [
    "CHANNELS",
    "FORMS",
    "FRAME_IDS",
    "MODULES",
    "NOMINAL_FLOW_L_PER_MIN",
    "OPEN_CIRCUIT",
    "PLACES",
    "Array",
    "Cells",
    "EffectFileError",
    "Form",
    "Instruments",
    "Plant",
    "PlantEffect",
    "Room",
    "SimulatedPlant",
    "ThermocoupleModule",
    "build_cells",
    "load_effects",
    "may_cache",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
