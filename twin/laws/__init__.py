"""General laws: their values on arrays, and their equation in words and symbols.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.laws.equation import law_equation, law_equations
    from twin.laws.values import law_values


__all__ = ["law_equation", "law_equations", "law_values"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "equation": ("law_equation", "law_equations"),
        "values": ("law_values",),
    },
)
