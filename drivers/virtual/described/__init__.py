"""Rig that is served as its rig file describes it.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.virtual.described.plant import ConstantPlant, PlantModel
    from drivers.virtual.described.server import ServeOptions, serve_described

_HOME = {
    "ConstantPlant": "drivers.virtual.described.plant",
    "PlantModel": "drivers.virtual.described.plant",
    "ServeOptions": "drivers.virtual.described.server",
    "serve_described": "drivers.virtual.described.server",
}

__all__ = ["ConstantPlant", "PlantModel", "ServeOptions", "serve_described"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
