"""Heat lost to the room, linear: Q = hA (T - T_amb).

Source: the ambient term of eq. 1 of Energies 2026, 19, 2452. Nodes that are built alike may share one hA: each of
them loses hA times its own difference. A loss that grows faster than the difference is `natural_convection`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment


@dataclass(frozen=True)
class AmbientLoss(Element):
    """A constant conductance to the room, from one node or from each of several that are alike."""

    kind: ClassVar[str] = "ambient_loss"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("hA", "W/K", None, 0.0, 1000.0, "tunable", "effective conductance to the room"),
    )

    node: str = place("node", "node that loses the heat")
    ambient: str = place("input", "input column with the room temperature in degC", unit="degC", default="T_ambient_C")
    alike: tuple[str, ...] = place("nodes", "further nodes that lose heat by the same hA", default="")

    def nodes(self) -> tuple[str, ...]:
        return (self.node, *self.alike)

    def problem(self, values: Mapping[str, float]) -> str | None:
        return "a node is named twice" if len(set(self.nodes())) != len(self.nodes()) else None

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {node for e in sites.having(cls.kind) for node in e.nodes()}
        return tuple(
            Candidate(
                "heat_loss",
                sites.places[node],
                "temperature_difference",
                "new",
                {f"{name}.hA": 1.0},
                "W/K",
                1.0,
                0.0,
                cls.upper_of("hA"),
                "loses {value} to the room",
                adds={name: {"kind": cls.kind, "node": node, "ambient": sites.room}},
            )
            for node in sites.nodes
            if sites.room and node not in having and (name := f"loss_of_{node}")
        )

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where = sites.places[self.node]
        says, now = "loses {value} more to the room than when commissioned", sites.values[f"{self.name}.hA"]
        size = EffectSize("W/K", 1.0, -now, self.upper_of("hA") - now)
        return (self.parameter_candidate("hA", "heat_loss", where, "temperature_difference", size, says),)

    def emit(self, n: Names) -> Fragment:
        hA = n.par("hA")
        room = n.input(self.ambient)
        return Fragment(
            heat={node: f"{hA} * ({room} - {n.temperature(node)})" for node in self.nodes()},
            conductance=dict.fromkeys(self.nodes(), hA),
        )
