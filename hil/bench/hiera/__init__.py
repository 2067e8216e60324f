"""Trials of the network calibrator and the other calibrators.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.hiera.cases import RIGS, HieraCase

__all__ = ["RIGS", "HieraCase", "ablations", "cases", "trial"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": (
            "ablations",
            "cases",
            "trial",
        ),
        "cases": ("RIGS", "HieraCase"),
    },
)
