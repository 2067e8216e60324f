"""Observations that several cells share: basin thermometers and makeup water.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.tower.shared_observations.basin import Drain, with_basin
    from twin.tower.shared_observations.evaporation import GAIN, Balance, with_evaporation


__all__ = ["GAIN", "Balance", "Drain", "with_basin", "with_evaporation"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "basin": ("Drain", "with_basin"),
        "evaporation": ("Balance", "GAIN", "with_evaporation"),
    },
)
