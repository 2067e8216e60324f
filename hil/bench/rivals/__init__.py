"""Trial of rivals of the Hiera-UNet on tower stations that no training saw, of its parts, and of a remedy.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.rivals.trial import FULL, QUICK, Limits, TrialSize, measure

__all__ = ["FULL", "QUICK", "Limits", "TrialSize", "measure"]

__getattr__, __dir__ = lazy_names(__name__, {"trial": ("FULL", "QUICK", "Limits", "TrialSize", "measure")})
