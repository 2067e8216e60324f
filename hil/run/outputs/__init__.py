"""Outputs of a rig: set-points, read-back, heaters, safe values.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.run.outputs.confirmation import WriteConfirmation
    from hil.run.outputs.deviations import ReadbackDeviations
    from hil.run.outputs.heaters import (
        DEAD_TIME_S,
        Descent,
        GoodReadings,
        is_heater,
        safe_limit,
        safe_limits,
        still_hot,
    )
    from hil.run.outputs.outputs import ARMING_TICKS, Outputs
    from hil.run.outputs.readback import SetpointReadback
    from hil.run.outputs.safing import Meanwhile, Safed, attempt_s, make_safe, write_safe
    from hil.run.outputs.setpoints import Setpoints, bind, setpoint_columns
    from hil.run.outputs.time_to_safe import SAFE_WITHIN_S, SILENCE_S, takes_s

__all__ = [
    "ARMING_TICKS",
    "DEAD_TIME_S",
    "SAFE_WITHIN_S",
    "SILENCE_S",
    "Descent",
    "GoodReadings",
    "Meanwhile",
    "Outputs",
    "ReadbackDeviations",
    "Safed",
    "SetpointReadback",
    "Setpoints",
    "WriteConfirmation",
    "attempt_s",
    "bind",
    "is_heater",
    "make_safe",
    "safe_limit",
    "safe_limits",
    "setpoint_columns",
    "still_hot",
    "takes_s",
    "write_safe",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "confirmation": ("WriteConfirmation",),
        "deviations": ("ReadbackDeviations",),
        "heaters": (
            "DEAD_TIME_S",
            "Descent",
            "GoodReadings",
            "is_heater",
            "safe_limit",
            "safe_limits",
            "still_hot",
        ),
        "outputs": (
            "ARMING_TICKS",
            "Outputs",
        ),
        "readback": ("SetpointReadback",),
        "safing": (
            "Meanwhile",
            "Safed",
            "attempt_s",
            "make_safe",
            "write_safe",
        ),
        "setpoints": (
            "Setpoints",
            "bind",
            "setpoint_columns",
        ),
        "time_to_safe": (
            "SAFE_WITHIN_S",
            "SILENCE_S",
            "takes_s",
        ),
    },
)
