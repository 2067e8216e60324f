"""Observations of one cell beside its thermometers: inspections, traverses, certificates, fan power.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.tower.cell_observations.evidence import Label, interval_as_gaussian
    from twin.tower.cell_observations.fan_power import AMPLITUDE, PowerErrors, PowerRows


__all__ = ["AMPLITUDE", "Label", "PowerErrors", "PowerRows", "interval_as_gaussian"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "evidence": ("Label", "interval_as_gaussian"),
        "fan_power": ("AMPLITUDE", "PowerErrors", "PowerRows"),
    },
)
