"""Estimates with their intervals as text."""

from __future__ import annotations

import math


def estimate_text(value: float, half_width: float) -> str:
    """Return an estimate with the half width of its interval, both to the second significant digit of that width.

    JCGM 100:2008 (GUM), 7.2.6.
    """
    if not 1e-6 < half_width < 1e7:
        return f"{value:.4g} ± {half_width:.2g}"
    digits = 1 - math.floor(math.log10(half_width))
    shown = max(digits, 0)
    return f"{round(value, digits):.{shown}f} ± {round(half_width, digits):.{shown}f}"
