"""Diagnosis of a twin's error: the residual is traced to a physical effect that the model lacks.

The names below are the package's interface; they are loaded on first use. Everything else is private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

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
    from twin.discovery.planning.experiment import Limits
    from twin.discovery.planning.forecast import Forecast
    from twin.discovery.records.grid import TooShortError, require_enough

_HOME = {
    "require_enough": "twin.discovery.records.grid",
    "Forecast": "twin.discovery.planning.forecast",
    "keep_bootstrap": "twin.discovery.healthy.claim_threshold",
    "fits_growth": "twin.discovery.growing.answer",
    "HELD_OUT_WORSE": "twin.discovery.evidence.held_out",
    "ambiguity_groups": "twin.discovery.effects.ambiguity_groups",
    "EffectLabel": "twin.discovery.effects.ambiguity_groups",
    "catalogue": "twin.discovery.effects.catalogue",
    "with_unused": "twin.discovery.answer.unused_inputs",
    "label_text": "twin.discovery.answer.blind_spots",
    "errors_on_further_record": "twin.discovery.further_records",
    "bootstrap_claims": "twin.discovery.bootstrap",
    "Columns": "twin.discovery.healthy.basis",
    "CommissionedRecord": "twin.discovery.healthy.basis",
    "Diagnosis": "twin.discovery.diagnosis",
    "Limits": "twin.discovery.planning.experiment",
    "NotHealthyError": "twin.discovery.healthy.health",
    "SensorError": "twin.discovery.diagnosis",
    "TooShortError": "twin.discovery.records.grid",
    "diagnose": "twin.discovery.engine",
    "diagnose_grown": "twin.discovery.growing.answer",
    "disturbance_statement": "twin.discovery.effects.statement",
    "foresee": "twin.discovery.engine",
    "foresee_plan": "twin.discovery.engine",
}

__all__ = [
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
    "with_unused",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
