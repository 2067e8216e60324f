"""Heat released in a node: Q = power (constant), or Q = factor * column.

Source: Q_j of eq. 1 of Energies 2026, 19, 2452. The heater's is its measured electrical power times the
"effective heat input" of Table 2; the modules' is the constant Q_pm of Table 1, zero in a healthy loop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place


@dataclass(frozen=True)
class HeatSource(Element):
    """A heat input, constant unless a driver column is named."""

    kind: ClassVar[str] = "heat_source"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("power", "W", 0.0, -1.0e5, 1.0e5, "tunable", "constant heat input; zero in a healthy loop"),
    )

    node: str = place("node", "node that receives the heat")
    driver: str = place("input", "input column with a power in W, left out for a constant source", default="")

    def inputs(self) -> tuple[str, ...]:
        return (self.driver,) if self.driver else ()

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        if not self.driver:
            return self.parameters
        return (ParameterSpec("factor", "1", 1.0, 0.0, 8.0, "tunable", "heat that arrives over power measured"),)

    def problem(self, values: Mapping[str, float]) -> str | None:
        if self.driver and not self.driver.endswith("_W"):
            return f"driver {self.driver!r} is not a power: its name does not end in _W"
        return None

    def emit(self, n: Names) -> Fragment:
        heat = f"{n.par('factor')} * {n.input(self.driver)}" if self.driver else n.par("power")
        return Fragment(heat={self.node: heat})
