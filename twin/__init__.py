"""Digital twin of a thermal plant: a network of elements, its simulation, its calibration and its diagnosis.

The names below are the package's interface, together with those of `twin.elements`, `twin.calibrators`,
`twin.discovery`, `twin.historian` and `twin.tower`. They are loaded on first use, so that importing the package costs
nothing. Modules that no interface names are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.column_names import UNITS_OF_SUFFIX, celsius_conversion, column_hint
    from twin.commissioning.checks import clock_warning, refusal_reason
    from twin.commissioning.healthy_fit import CommissionOptions, CommissionResult, commission
    from twin.drawing import draw
    from twin.elements.base import STAMP
    from twin.kernel.simulation import Kernel, hold_inputs, mask_measurements, simulate
    from twin.laws.equation import law_equations
    from twin.network.model import Array, InputSpec, Network, Revision, TunableSet, TwinFileError, WindowRules
    from twin.quantiles import NORMAL90
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


__all__ = [
    "LONG_GAP_S",
    "NORMAL90",
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

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "column_names": ("UNITS_OF_SUFFIX", "celsius_conversion", "column_hint"),
        "commissioning.checks": ("clock_warning", "refusal_reason"),
        "commissioning.healthy_fit": ("CommissionOptions", "CommissionResult", "commission"),
        "drawing": ("draw",),
        "elements.base": ("STAMP",),
        "kernel.simulation": ("Kernel", "hold_inputs", "mask_measurements", "simulate"),
        "laws.equation": ("law_equations",),
        "network.model": ("Array", "InputSpec", "Network", "Revision", "TunableSet", "TwinFileError", "WindowRules"),
        "quantiles": ("NORMAL90",),
        "reference_simulation": ("right_hand_side", "simulate_exact", "simulate_fine_steps"),
        "revisions.revision_chain": (
            "ChainEntry",
            "ElementDiff",
            "TwinDiff",
            "chain",
            "diff",
            "next_path",
            "parent_of",
            "revert",
            "save_revision",
            "with_elements",
        ),
        "segments": ("LONG_GAP_S", "Segments", "find_segments", "segment_rows", "simulate_segments"),
        "steady": ("steady_readings", "steady_state"),
        "tracking": ("TrackerUpdate", "TwinTracker"),
        "twinfile.datasheet": ("from_datasheet",),
        "twinfile.toml_text": ("dump", "load", "parse", "save"),
    },
)
