"""Audit of the network calibrator: measures each known cause of its blindness, on windows of simulated plants.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.audit.trial import FULL, QUICK, AuditSize, measure

__all__ = ["FULL", "QUICK", "AuditSize", "measure"]

__getattr__, __dir__ = lazy_names(__name__, {"trial": ("FULL", "QUICK", "AuditSize", "measure")})
