"""Bench of unmodelled effects that are found while a record goes on: a network and its linear rival on random plants.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from hil.lazy_names import lazy_names

__all__ = ["store", "training", "trial"]

__getattr__, __dir__ = lazy_names(__name__, {"": ("store", "training", "trial")})
