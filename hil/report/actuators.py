"""Set-points of a rig with the signals that read them back."""

from __future__ import annotations

import re
from collections.abc import Sequence

from drivers.signals import Signal

_SETPOINT_SUFFIX = re.compile(r"_(set|setpoint|sp|cmd|command|target|demand)$")


def pair_actuators(signals: Sequence[Signal]) -> dict[str, tuple[Signal, ...]]:
    """Return set-points by name without suffix, each with its read-back: the declared one, else one of that name or of
    the same role.
    """
    measured = [signal for signal in signals if signal.kind == "measured"]
    pairs: dict[str, tuple[Signal, ...]] = {}
    for setpoint in (signal for signal in signals if signal.kind == "setpoint"):
        stem = _SETPOINT_SUFFIX.sub("", setpoint.name)
        found = [
            signal
            for signal in measured
            if signal.unit == setpoint.unit
            and setpoint.readback in (None, signal.name)
            and (
                signal.name == setpoint.readback
                or signal.name.startswith(stem)
                or (signal.role is not None and signal.role == setpoint.role)
            )
        ]
        pairs[stem] = (setpoint, *found[:1])
    return pairs
