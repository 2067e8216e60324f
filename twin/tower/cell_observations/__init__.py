"""Observations of one cell beside its thermometers: inspections, traverses, certificates, fan power.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.tower.cell_observations.evidence import Label, interval_as_gaussian
    from twin.tower.cell_observations.fan_power import AMPLITUDE, PowerErrors, PowerRows

_MODULES = {
    "evidence": (
        "Label",
        "interval_as_gaussian",
    ),
    "fan_power": (
        "AMPLITUDE",
        "PowerErrors",
        "PowerRows",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = ["AMPLITUDE", "Label", "PowerErrors", "PowerRows", "interval_as_gaussian"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
