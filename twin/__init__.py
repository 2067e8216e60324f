"""Digital twin of a thermal plant: a network of elements, its simulation, its calibration and its diagnosis.

The names below are the package's interface, together with those of `twin.elements`, `twin.calibrators`,
`twin.discovery`, `twin.historian` and `twin.tower`. They are loaded on first use, so that importing the package costs
nothing. Modules that no interface names are private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.column_names import UNITS_OF_SUFFIX, celsius_conversion, column_hint
    from twin.commissioning.checks import clock_warning, refusal_reason
    from twin.commissioning.healthy_fit import CommissionOptions, CommissionResult, commission
    from twin.drawing import draw
    from twin.elements.base import STAMP
    from twin.kernel.simulation import Kernel, hold_inputs, mask_measurements, simulate
    from twin.laws.equation import law_equations
    from twin.network.model import Array, InputSpec, Network, Revision, TunableSet, TwinFileError, WindowRules
    from twin.reference_simulation import right_hand_side, simulate_exact, simulate_fine_steps
    from twin.revisions.revision_chain import (
        ChainEntry,
        ElementDiff,
        TwinDiff,
        chain,
        diff,
        next_path,
        parent_of,
        revert,
        save_revision,
        with_elements,
    )
    from twin.segments import LONG_GAP_S, Segments, find_segments, segment_rows, simulate_segments
    from twin.steady import steady_readings, steady_state
    from twin.tracking import TrackerUpdate, TwinTracker
    from twin.twinfile.datasheet import from_datasheet
    from twin.twinfile.toml_text import dump, load, parse, save

_MODULES = {
    "twin.laws.equation": ("law_equations",),
    "twin.elements.base": ("STAMP",),
    "twin.column_names": ("UNITS_OF_SUFFIX", "celsius_conversion", "column_hint"),
    "twin.commissioning.checks": ("clock_warning", "refusal_reason"),
    "twin.commissioning.healthy_fit": ("CommissionOptions", "CommissionResult", "commission"),
    "twin.twinfile.datasheet": ("from_datasheet",),
    "twin.drawing": ("draw",),
    "twin.kernel.simulation": ("Kernel", "hold_inputs", "mask_measurements", "simulate"),
    "twin.network.model": ("Array", "InputSpec", "Network", "Revision", "TunableSet", "TwinFileError", "WindowRules"),
    "twin.reference_simulation": ("right_hand_side", "simulate_exact", "simulate_fine_steps"),
    "twin.revisions.revision_chain": (
        *("ChainEntry", "ElementDiff", "TwinDiff", "chain", "diff", "next_path", "parent_of", "revert"),
        *("save_revision", "with_elements"),
    ),
    "twin.segments": ("LONG_GAP_S", "Segments", "find_segments", "segment_rows", "simulate_segments"),
    "twin.steady": ("steady_readings", "steady_state"),
    "twin.tracking": ("TrackerUpdate", "TwinTracker"),
    "twin.twinfile.toml_text": ("dump", "load", "parse", "save"),
}
_HOME = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "LONG_GAP_S",
    "STAMP",
    "UNITS_OF_SUFFIX",
    "Array",
    "ChainEntry",
    "CommissionOptions",
    "CommissionResult",
    "ElementDiff",
    "InputSpec",
    "Kernel",
    "Network",
    "Revision",
    "Segments",
    "TrackerUpdate",
    "TunableSet",
    "TwinDiff",
    "TwinFileError",
    "TwinTracker",
    "WindowRules",
    "celsius_conversion",
    "chain",
    "clock_warning",
    "column_hint",
    "commission",
    "diff",
    "draw",
    "dump",
    "find_segments",
    "from_datasheet",
    "hold_inputs",
    "law_equations",
    "load",
    "mask_measurements",
    "next_path",
    "parent_of",
    "parse",
    "refusal_reason",
    "revert",
    "right_hand_side",
    "save",
    "save_revision",
    "segment_rows",
    "simulate",
    "simulate_exact",
    "simulate_fine_steps",
    "simulate_segments",
    "steady_readings",
    "steady_state",
    "with_elements",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
