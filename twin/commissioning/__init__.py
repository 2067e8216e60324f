"""Commissioning: the fit of a twin to a healthy record, and the checks of its result.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.commissioning.checks import clock_warning, refusal_reason
    from twin.commissioning.healthy_fit import (
        INITIAL_SD_K,
        CommissionOptions,
        CommissionResult,
        commission,
        variance_inflation,
        weak_prior,
    )

_MODULES = {
    "checks": (
        "clock_warning",
        "refusal_reason",
    ),
    "healthy_fit": (
        "CommissionOptions",
        "CommissionResult",
        "INITIAL_SD_K",
        "commission",
        "variance_inflation",
        "weak_prior",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "INITIAL_SD_K",
    "CommissionOptions",
    "CommissionResult",
    "clock_warning",
    "commission",
    "refusal_reason",
    "variance_inflation",
    "weak_prior",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
