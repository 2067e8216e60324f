"""General laws: their values on arrays, and their equation in words and symbols.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.laws.equation import law_equation, law_equations
    from twin.laws.values import law_values

_MODULES = {
    "equation": (
        "law_equation",
        "law_equations",
    ),
    "values": ("law_values",),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = ["law_equation", "law_equations", "law_values"]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
