"""Network of elements: its model, the checks of its structure, and its equations as one system.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
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
    },
)
