"""Heat lost to the room, linear: Q = hA (T - T_amb).

Source: the ambient term of eq. 1 of Energies 2026, 19, 2452. Nodes that are built alike may share one hA: each of
them loses hA times its own difference. A loss that grows faster than the difference is `natural_convection`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place


@dataclass(frozen=True)
class AmbientLoss(Element):
    """A constant conductance to the room, from one node or from each of several that are alike."""

    kind: ClassVar[str] = "ambient_loss"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("hA", "W/K", None, 0.0, 1000.0, "tunable", "effective, Table 1 of the paper"),
    )

    node: str = place("node", "node that loses the heat")
    ambient: str = place("input", "input column with the room temperature in degC", default="T_ambient_C")
    alike: tuple[str, ...] = place("nodes", "further nodes that lose heat by the same hA", default="")

    def nodes(self) -> tuple[str, ...]:
        return (self.node, *self.alike)

    def problem(self, values: Mapping[str, float]) -> str | None:
        return "a node is named twice" if len(set(self.nodes())) != len(self.nodes()) else None

    def emit(self, n: Names) -> Fragment:
        hA = n.par("hA")
        room = n.input(self.ambient)
        return Fragment(
            heat={node: f"{hA} * ({room} - {n.temperature(node)})" for node in self.nodes()},
            conductance=dict.fromkeys(self.nodes(), hA),
        )
