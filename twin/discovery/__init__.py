"""Diagnosis of a twin's error: the residual is traced to a physical effect that the model lacks.

The names below are the package's interface; they are loaded on first use. Everything else is private to the package.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from twin.discovery.diagnosis import Diagnosis, SensorError
    from twin.discovery.effects.statement import disturbance_statement
    from twin.discovery.engine import diagnose, foresee, foresee_plan
    from twin.discovery.growing.answer import diagnose_grown
    from twin.discovery.healthy.basis import Columns, CommissionedRecord
    from twin.discovery.healthy.health import NotHealthyError
    from twin.discovery.planning.experiment import Limits
    from twin.discovery.records.grid import TooShortError

_HOME = {
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
    "Columns",
    "CommissionedRecord",
    "Diagnosis",
    "Limits",
    "NotHealthyError",
    "SensorError",
    "TooShortError",
    "diagnose",
    "diagnose_grown",
    "disturbance_statement",
    "foresee",
    "foresee_plan",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
