"""Trained weights: files and identity, binding to a twin, intervals, envelope, leakage test, device and latency.

The names below are the package's interface; they are loaded on first use, because some need the extra ``ml``.
Modules among them are public as a whole. Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.weights.checkpoint import Identity, Member


__all__ = [
    "Identity",
    "Member",
    "binding",
    "checkpoint",
    "conformal",
    "device",
    "ensemble",
    "envelope",
    "leakage",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("binding", "checkpoint", "conformal", "device", "ensemble", "envelope", "leakage"),
        "checkpoint": ("Identity", "Member"),
    },
)
