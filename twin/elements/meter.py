"""Meter of a quantity that another element exports: heat, power, mass flow, or a position.

    reading = gain * quantity + bias + noise

The quantity is that of the instant of the sample, from the inputs and temperatures of that sample. Its unit follows
from the suffix of the column: ``_W``, ``_kW``, ``_kg_s`` or ``_pct``; a power in W may be read in kW and the other way
round. A fit weighs the residual with 1 / sigma, as that of a thermometer. Wherever the twin's error is stated as one
number in K, one sigma of a meter counts as much as one sigma of a usual thermometer, `USUAL_K`.

Source: gain and bias of an instrument as in the Guide to the Expression of Uncertainty in Measurement, JCGM 100:2008,
annex H.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.fragments import Fragment, Metered

UNITS = {"_kg_s": "kg/s", "_kW": "kW", "_W": "W", "_pct": "%"}
"""Suffix of a column -> unit."""
POWERS = {"W": 1.0, "kW": 1000.0}
"""W."""
QUANTITIES = ("heat", "heat_rejected", "fan_power", "evaporation", "mass_flow", "delivered")
METERED = ("heat_source", "exchanger", "tower_cell", "flow", "actuator")
"""Kinds of elements that export a quantity."""
USUAL_K = 0.05
"""Standard deviation of a usual thermometer, K: the default of `sensor`."""


def unit_of(column: str) -> str:
    """Return the unit of a metered column by its suffix, "" where it has none."""
    return next((unit for suffix, unit in UNITS.items() if column.endswith(suffix)), "")


@dataclass(frozen=True)
class Meter(Element):
    """Meter at an element; its name is the name of the reading in every table."""

    kind: ClassVar[str] = "meter"

    of: str = place("element", "element whose quantity is read", kinds=METERED)
    quantity: str = place("choice", "quantity that is read", choices=QUANTITIES)
    measured: tuple[str, ...] = place("columns", "measured columns that are averaged", key="columns")

    @property
    def unit(self) -> str:
        """Unit of the readings, by the suffix of their columns."""
        return unit_of(self.measured[0]) or self.measured[0].rsplit("_", 1)[-1]

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        unit = self.unit
        return (
            ParameterSpec("sigma", unit, None, 1.0e-6, 1.0e6, "fixed", "standard deviation of one meter"),
            ParameterSpec("gain", "1", 1.0, 0.2, 5.0, "fixed", "1 for a meter in calibration"),
            ParameterSpec("bias", unit, 0.0, -1.0e6, 1.0e6, "fixed", "offset; 0 for a meter in calibration"),
        )

    def problem(self, values: Mapping[str, float]) -> str | None:
        bad = [column for column in self.measured if unit_of(column) != self.unit]
        if bad:
            return f"column {bad[0]!r} has no unit that a meter reads: end its name in {', '.join(UNITS)}, all alike"
        return None

    def factor(self, unit: str) -> float | None:
        """Return the readings' size of one `unit` of the quantity, None where the two are of different kinds."""
        if unit == self.unit:
            return 1.0
        return POWERS[unit] / POWERS[self.unit] if unit in POWERS and self.unit in POWERS else None

    def emit(self, n: Names) -> Fragment:
        reading = n.local("metered")
        metered = Metered(self.of, self.quantity, reading, {u: self.factor(u) or 1.0 for u in (*POWERS, self.unit)})
        if n.constant("gain") != 1.0:
            reading = f"{n.par('gain')} * {reading}"
        if n.constant("bias") != 0.0:
            reading += f" + {n.par('bias')}"
        return Fragment(observe=reading, metered=metered)
