"""Simulated rigs to learn from: plants, loads, undeclared changes, gaps, and their windows in a store.

The names below are the package's interface; they are loaded on first use. Modules among them are public as a whole.
Everything else is private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.simulated.campaigns import LabelledRecord
    from twin.calibrators.hiera_unet.simulated.plants import Family
    from twin.calibrators.hiera_unet.simulated.store import Store

_MODULES = {
    "campaigns": ("LabelledRecord",),
    "plants": ("Family",),
    "store": ("Store",),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

_PUBLIC_MODULES = ("campaigns", "gaps", "store")

__all__ = [
    "Family",
    "LabelledRecord",
    "Store",
    "campaigns",
    "gaps",
    "store",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name in _PUBLIC_MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
