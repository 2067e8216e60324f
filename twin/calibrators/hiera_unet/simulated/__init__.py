"""Simulated rigs to learn from: plants, loads, undeclared changes, gaps, and their windows in a store.

The names below are the package's interface; they are loaded on first use. Modules among them are public as a whole.
Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.simulated.campaigns import LabelledRecord
    from twin.calibrators.hiera_unet.simulated.plants import Family
    from twin.calibrators.hiera_unet.simulated.store import Store


__all__ = [
    "Family",
    "LabelledRecord",
    "Store",
    "campaigns",
    "gaps",
    "store",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("campaigns", "gaps", "store"),
        "campaigns": ("LabelledRecord",),
        "plants": ("Family",),
        "store": ("Store",),
    },
)
