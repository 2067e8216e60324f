"""Twins that track a run, and the adoption of their parameters.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.tracking.adoption import (
        Adoption,
        Advice,
        NetworkMode,
        accepted,
        adopt,
        adoption_manifest,
        closed_gates,
        offset_text,
    )
    from hil.tracking.child_process import Child
    from hil.tracking.process import Tracking, TrackingError
    from hil.tracking.record_replay import Replay, replay, write_predictions
    from hil.tracking.results import Results
    from hil.tracking.twins import (
        DEFAULT,
        STATIC,
        Comparison,
        ErrorTable,
        Proposed,
        TrackingConfig,
        Twins,
        disturbance,
        parameter_cell,
        too_coarse,
        window_kind,
        window_words,
    )

__all__ = [
    "DEFAULT",
    "STATIC",
    "Adoption",
    "Advice",
    "Child",
    "Comparison",
    "ErrorTable",
    "NetworkMode",
    "Proposed",
    "Replay",
    "Results",
    "Tracking",
    "TrackingConfig",
    "TrackingError",
    "Twins",
    "accepted",
    "adopt",
    "adoption_manifest",
    "closed_gates",
    "disturbance",
    "offset_text",
    "parameter_cell",
    "replay",
    "too_coarse",
    "window_kind",
    "window_words",
    "write_predictions",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "adoption": (
            "Adoption",
            "Advice",
            "NetworkMode",
            "accepted",
            "adopt",
            "closed_gates",
            "adoption_manifest",
            "offset_text",
        ),
        "child_process": ("Child",),
        "process": (
            "Tracking",
            "TrackingError",
        ),
        "record_replay": ("Replay", "replay", "write_predictions"),
        "results": ("Results",),
        "twins": (
            "Comparison",
            "DEFAULT",
            "ErrorTable",
            "Proposed",
            "STATIC",
            "TrackingConfig",
            "Twins",
            "disturbance",
            "parameter_cell",
            "too_coarse",
            "window_kind",
            "window_words",
        ),
    },
)
