"""Gauss-Newton estimate over the context: evidence for the network, and what few moved parameters would explain.

The names below are the package's interface; they are loaded on first use. Modules among them are public as a whole.
Everything else is private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.calibrators.hiera_unet.context_fit.evidence import ContextFit, ParameterPrior

_MODULES = {
    "evidence": ("ContextFit", "ParameterPrior"),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

_PUBLIC_MODULES = ("evidence",)

__all__ = [
    "ContextFit",
    "ParameterPrior",
    "evidence",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name in _PUBLIC_MODULES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
