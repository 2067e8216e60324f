"""Plant of the virtual rig and its instruments.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "ambient": ("Room",),
        "effects": ("EffectFileError", "FORMS", "Form", "PlantEffect", "load_effects"),
        "geometry": ("Array", "CHANNELS", "Cells", "MODULES", "PLACES", "build_cells"),
        "instruments": ("Instruments",),
        "kernel": ("NOMINAL_FLOW_L_PER_MIN",),
        "machine_code": ("may_cache",),
        "plant": ("Plant",),
        "simulated_plant": ("SimulatedPlant",),
        "thermocouple_module": ("FRAME_IDS", "OPEN_CIRCUIT", "ThermocoupleModule"),
    },
)
