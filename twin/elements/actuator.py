"""What becomes of a command: the elements see the output of an actuator instead of its input column.

    c(t)  = command(t - dead_time_s)
    lag_s * da/dt = c - a
    value = gain * a * (1 - droop * a / full)

The value is the mean over each sample interval, so that it is continuous in dead time and lag and no energy is
lost between the samples. With gain = 1 and everything else 0 it is the column itself.

Source: first-order lag with dead time (Astrom & Hagglund, Advanced PID Control, 2006, sec. 2.5); `droop` is the share
that is missing at full command, as in a supply that sags or a pump that works against its own friction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Drive, Element, Fragment, Names, ParameterSpec, place


@dataclass(frozen=True)
class Actuator(Element):
    """Gain, droop, dead time and lag of one input column."""

    kind: ClassVar[str] = "actuator"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("gain", "1", 1.0, 0.0, 8.0, "fixed", "output over command"),
        ParameterSpec("droop", "1", 0.0, -0.5, 0.9, "fixed", "share missing at full command"),
        ParameterSpec("dead_time_s", "s", 0.0, 0.0, 600.0, "fixed", "time before a command shows"),
        ParameterSpec("lag_s", "s", 0.0, 0.0, 3600.0, "fixed", "time constant of the output"),
    )

    column: str = place("input", "input column with the command")

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        suffix = self.column.rsplit("_", 1)[-1]
        unit = {"pct": "%", "C": "degC"}.get(suffix, suffix)
        full = 1000.0 if suffix == "W" else 100.0
        return (*self.parameters, ParameterSpec("full", unit, full, 1.0e-3, 1.0e6, "fixed", "full command"))

    def emit(self, n: Names) -> Fragment:
        value = n.arrived()
        if n.constant("gain") != 1.0:
            value = f"{n.par('gain')} * {value}"
        if n.constant("droop") != 0.0:
            value += f" * (1.0 - {n.par('droop')} * {n.arrived()} / {n.par('full')})"
        dead_time = None if n.constant("dead_time_s") == 0.0 else n.par("dead_time_s")
        lag = None if n.constant("lag_s") == 0.0 else n.par("lag_s")
        if value == n.arrived() and dead_time is None and lag is None:
            return Fragment()
        return Fragment(drive=Drive(self.column, value, dead_time, lag))
