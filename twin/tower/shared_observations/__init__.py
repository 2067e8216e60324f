"""Observations that several cells share: basin thermometers and makeup water.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.tower.shared_observations.basin import Drain, with_basin
    from twin.tower.shared_observations.evaporation import GAIN, Balance, with_evaporation

_MODULES = {
    "basin": (
        "Drain",
        "with_basin",
    ),
    "evaporation": (
        "Balance",
        "GAIN",
        "with_evaporation",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = ["GAIN", "Balance", "Drain", "with_basin", "with_evaporation"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
