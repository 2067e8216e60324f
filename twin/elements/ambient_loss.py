"""Heat lost to the room, linear: Q = hA (T - T_amb).

Source: the ambient term of eq. 1 of Energies 2026, 19, 2452.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place


@dataclass(frozen=True)
class AmbientLoss(Element):
    """A constant conductance from one node to the room."""

    kind: ClassVar[str] = "ambient_loss"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("hA", "W/K", None, 0.0, 1000.0, "tunable", "effective, Table 1 of the paper"),
    )

    node: str = place("node", "node that loses the heat")
    ambient: str = place("input", "input column with the room temperature in degC", default="T_ambient_C")

    def emit(self, n: Names) -> Fragment:
        hA = n.par("hA")
        return Fragment(
            heat={self.node: f"{hA} * ({n.input(self.ambient)} - {n.temperature(self.node)})"},
            conductance={self.node: hA},
        )
