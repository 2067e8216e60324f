"""Kernel of a network: generated source text, checked, compiled, cached, and called with arrays.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.kernel.c_translator import CSource, c_source
    from twin.kernel.cache import cache_folder, compile_kernel
    from twin.kernel.codegen import FEW_LANES, LANES
    from twin.kernel.generated_code import define_functions, evaluate_formula
    from twin.kernel.simulation import Kernel, clean_time, hold_inputs, mask_measurements, simulate, with_stamps

_MODULES = {
    "cache": (
        "cache_folder",
        "compile_kernel",
    ),
    "c_translator": (
        "CSource",
        "c_source",
    ),
    "codegen": (
        "FEW_LANES",
        "LANES",
    ),
    "generated_code": (
        "define_functions",
        "evaluate_formula",
    ),
    "simulation": (
        "Kernel",
        "clean_time",
        "hold_inputs",
        "mask_measurements",
        "simulate",
        "with_stamps",
    ),
}
_HOME = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "FEW_LANES",
    "LANES",
    "CSource",
    "Kernel",
    "c_source",
    "cache_folder",
    "clean_time",
    "compile_kernel",
    "define_functions",
    "evaluate_formula",
    "hold_inputs",
    "mask_measurements",
    "simulate",
    "with_stamps",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
