"""Diagnosis of a twin's error: the residual is traced to a physical effect that the model lacks.

The names below are the package's interface; they are loaded on first use. Everything else is private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.lazy_names import lazy_names

if TYPE_CHECKING:
    from twin.discovery.answer.blind_spots import label_text
    from twin.discovery.answer.unused_inputs import with_unused
    from twin.discovery.bootstrap import bootstrap_claims
    from twin.discovery.diagnosis import Diagnosis, SensorError
    from twin.discovery.effects.ambiguity_groups import EffectLabel, ambiguity_groups
    from twin.discovery.effects.catalogue import catalogue
    from twin.discovery.effects.statement import disturbance_statement
    from twin.discovery.engine import diagnose, foresee, foresee_plan
    from twin.discovery.evidence.held_out import HELD_OUT_WORSE
    from twin.discovery.further_records import errors_on_further_record
    from twin.discovery.growing.answer import diagnose_grown, fits_growth
    from twin.discovery.healthy.basis import Columns, CommissionedRecord
    from twin.discovery.healthy.claim_threshold import keep_bootstrap
    from twin.discovery.healthy.health import NotHealthyError
    from twin.discovery.mistaken_columns import column_mistakes
    from twin.discovery.planning.experiment import FLOW_MEASURED, Limits
    from twin.discovery.planning.forecast import Forecast
    from twin.discovery.records.grid import TooShortError, require_enough
    from twin.discovery.records.stuck_readings import stuck


__all__ = [
    "FLOW_MEASURED",
    "HELD_OUT_WORSE",
    "Columns",
    "CommissionedRecord",
    "Diagnosis",
    "EffectLabel",
    "Forecast",
    "Limits",
    "NotHealthyError",
    "SensorError",
    "TooShortError",
    "ambiguity_groups",
    "bootstrap_claims",
    "catalogue",
    "column_mistakes",
    "diagnose",
    "diagnose_grown",
    "disturbance_statement",
    "errors_on_further_record",
    "fits_growth",
    "foresee",
    "foresee_plan",
    "keep_bootstrap",
    "label_text",
    "require_enough",
    "stuck",
    "with_unused",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "answer.blind_spots": ("label_text",),
        "answer.unused_inputs": ("with_unused",),
        "bootstrap": ("bootstrap_claims",),
        "mistaken_columns": ("column_mistakes",),
        "diagnosis": ("Diagnosis", "SensorError"),
        "effects.ambiguity_groups": ("EffectLabel", "ambiguity_groups"),
        "effects.catalogue": ("catalogue",),
        "effects.statement": ("disturbance_statement",),
        "engine": ("diagnose", "foresee", "foresee_plan"),
        "evidence.held_out": ("HELD_OUT_WORSE",),
        "further_records": ("errors_on_further_record",),
        "growing.answer": ("diagnose_grown", "fits_growth"),
        "healthy.basis": ("Columns", "CommissionedRecord"),
        "healthy.claim_threshold": ("keep_bootstrap",),
        "healthy.health": ("NotHealthyError",),
        "planning.experiment": ("FLOW_MEASURED", "Limits"),
        "planning.forecast": ("Forecast",),
        "records.grid": ("TooShortError", "require_enough"),
        "records.stuck_readings": ("stuck",),
    },
)
