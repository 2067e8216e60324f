"""Kernel of a network: generated source text, checked, compiled, cached, and called with arrays.

The names below are the package's interface; they are loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.kernel.c_translator import CSource, c_source
    from twin.kernel.cache import cache_folder, compile_kernel
    from twin.kernel.codegen import FEW_LANES, LANES
    from twin.kernel.generated_code import define_functions, evaluate_formula
    from twin.kernel.simulation import Kernel, clean_time, hold_inputs, mask_measurements, simulate, with_stamps


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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "c_translator": ("CSource", "c_source"),
        "cache": ("cache_folder", "compile_kernel"),
        "codegen": ("FEW_LANES", "LANES"),
        "generated_code": ("define_functions", "evaluate_formula"),
        "simulation": ("Kernel", "clean_time", "hold_inputs", "mask_measurements", "simulate", "with_stamps"),
    },
)
