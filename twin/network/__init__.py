"""Network of elements: its model, the checks of its structure, and its equations as one system.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.network.model import (
        Array,
        InputSpec,
        Network,
        Revision,
        TunableSet,
        TwinFileError,
        WindowRules,
        did_you_mean,
        digest,
        frozen_mapping,
        mean_of_sensors,
    )
    from twin.network.topology import check_topology

_MODULES = {
    "model": (
        "Array",
        "InputSpec",
        "Network",
        "Revision",
        "TunableSet",
        "TwinFileError",
        "WindowRules",
        "did_you_mean",
        "digest",
        "frozen_mapping",
        "mean_of_sensors",
    ),
    "topology": ("check_topology",),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "Array",
    "InputSpec",
    "Network",
    "Revision",
    "TunableSet",
    "TwinFileError",
    "WindowRules",
    "check_topology",
    "did_you_mean",
    "digest",
    "frozen_mapping",
    "mean_of_sensors",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
