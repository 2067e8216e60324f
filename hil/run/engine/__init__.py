"""Engine of a run: ticks, states, interlocks, requests of operators.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.run.engine.clock import LOCKSTEP_DEADLINE_S, Clock, LockstepClock, MonotonicClock
    from hil.run.engine.components import Options
    from hil.run.engine.control_socket import ControlError, ask, live_runs, serving
    from hil.run.engine.engine import Engine
    from hil.run.engine.recording import Publisher
    from hil.run.engine.signals import RunSignals, cancelling, interrupted, stopping
    from hil.run.engine.status import Outcome, Status

__all__ = [
    "LOCKSTEP_DEADLINE_S",
    "Clock",
    "ControlError",
    "Engine",
    "LockstepClock",
    "MonotonicClock",
    "Options",
    "Outcome",
    "Publisher",
    "RunSignals",
    "Status",
    "ask",
    "cancelling",
    "interrupted",
    "live_runs",
    "serving",
    "stopping",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "clock": (
            "Clock",
            "LOCKSTEP_DEADLINE_S",
            "LockstepClock",
            "MonotonicClock",
        ),
        "components": ("Options",),
        "control_socket": (
            "ControlError",
            "ask",
            "live_runs",
            "serving",
        ),
        "engine": ("Engine",),
        "recording": ("Publisher",),
        "signals": (
            "RunSignals",
            "cancelling",
            "interrupted",
            "stopping",
        ),
        "status": (
            "Outcome",
            "Status",
        ),
    },
)
