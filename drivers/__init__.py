"""Drivers: rig files, signals, Modbus and CAN buses, historians, and the virtual rig.

The packages below are the interface; each names its own public objects. They are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

__all__ = ["bus", "can", "historian", "importers", "modbus", "rig", "rig_file", "signals", "virtual"]


def __getattr__(name: str) -> ModuleType:
    """Load a package on first use."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")


def __dir__() -> list[str]:
    """Return the public packages."""
    return sorted(__all__)
