"""Chaos campaign: attacks at random instants on a run in a process of its own.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.chaos.kinds import CHAOS_KINDS

__all__ = ["CHAOS_KINDS", "campaign"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("campaign",),
        "kinds": ("CHAOS_KINDS",),
    },
)
