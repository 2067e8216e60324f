"""Rig that is served as its rig file describes it.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.lazy_names import lazy_names

if TYPE_CHECKING:
    from drivers.virtual.described.plant import ConstantPlant, PlantModel
    from drivers.virtual.described.server import ServeOptions, serve_described

__all__ = ["ConstantPlant", "PlantModel", "ServeOptions", "serve_described"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "plant": (
            "ConstantPlant",
            "PlantModel",
        ),
        "server": (
            "ServeOptions",
            "serve_described",
        ),
    },
)
