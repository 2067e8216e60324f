"""Governance of a calibration on simulated stations: ramp of the fill, cleaning of nozzles, gates, proposals, alarms.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.tower_governance.cases import FULL, QUICK, TrialSize
    from hil.bench.tower_governance.trial import measure

__all__ = ["FULL", "QUICK", "TrialSize", "measure"]

__getattr__, __dir__ = lazy_names(__name__, {"cases": ("FULL", "QUICK", "TrialSize"), "trial": ("measure",)})
