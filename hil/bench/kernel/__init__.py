"""Cost of the twin's kernel and of its fits, and that of other tools.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.bench.kernel.problems import SIGMA_K, Problem
    from hil.bench.kernel.windows import Job, steady_start

__all__ = ["SIGMA_K", "Job", "Problem", "fit", "speed", "steady_start"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "": (
            "fit",
            "speed",
        ),
        "problems": (
            "Problem",
            "SIGMA_K",
        ),
        "windows": (
            "Job",
            "steady_start",
        ),
    },
)
