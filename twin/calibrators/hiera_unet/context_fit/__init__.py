"""Gauss-Newton estimate over the context: evidence for the network, and what few moved parameters would explain.

The names below are the package's interface; they are loaded on first use. Modules among them are public as a whole.
Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.context_fit.evidence import ContextFit, ParameterPrior


__all__ = [
    "ContextFit",
    "ParameterPrior",
    "evidence",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": ("evidence",),
        "evidence": ("ContextFit", "ParameterPrior"),
    },
)
