"""Commissioning: the fit of a twin to a healthy record, and the checks of its result.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "checks": ("clock_warning", "refusal_reason"),
        "healthy_fit": (
            "CommissionOptions",
            "CommissionResult",
            "INITIAL_SD_K",
            "commission",
            "variance_inflation",
            "weak_prior",
        ),
    },
)
