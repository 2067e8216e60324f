"""Law of a fluid: value kg/s into a node whose volume overflows, cp value (temperature - T).

Driver, form and time course of the value, and the source of its balance: `law`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Names, ParameterSpec, place
from twin.elements.candidates import INTERMITTENT, Candidate, Sites
from twin.elements.fragments import Fragment
from twin.elements.law import Law

FILLED_IN = {"cold": (10.0, ""), "hot": (60.0, ", or as much heat")}
"""Temperature of water from the mains and from a boiler, degC, and what else it may be. A record tells the product of
its amount and of how far it is from the rig's temperature."""
TYPICAL_FILLING, MOST_FILLING = 1.0 / 60.0, 10.0
"""A litre a minute, and a bucket in a second, kg/s."""


@dataclass(frozen=True)
class LawFluid(Law):
    """Fluid of a given temperature that enters a node and displaces as much of its content."""

    kind: ClassVar[str] = "law_fluid"
    unit: ClassVar[str] = "kg/s"
    most: ClassVar[float] = 1.0e3
    total: ClassVar[tuple[str, float]] = ("kg", 1.0e4)

    node: str = place("node", "node that the fluid enters")

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        """Return water that is filled in for a time where water flows."""
        wet, known = {*sites.before, *sites.before.values()}, {e.name for e in sites.having(cls.kind)}
        return tuple(
            Candidate(
                "heat_source",
                sites.places[node],
                "constant",
                "new",
                {f"{name}.size": 1.0},
                "kg/s",
                TYPICAL_FILLING,
                0.0,
                MOST_FILLING,
                f"gets {{value}} of {word} water (of {temperature:.0f} degC, or more of less {word} water{otherwise})",
                adds={name: {"kind": cls.kind, "node": node, "temperature": temperature}},
                shapes=INTERMITTENT,
            )
            for node in sites.nodes
            if node in wet
            for word, (temperature, otherwise) in FILLED_IN.items()
            if (name := f"{word}_water_into_{node}") not in known
        )

    def own_nodes(self) -> tuple[str, ...]:
        return (self.node,)

    def own_specs(self) -> tuple[ParameterSpec, ...]:
        return (
            ParameterSpec("temperature", "degC", None, -50.0, 200.0, "fixed", "of the fluid that enters"),
            ParameterSpec("cp", "J/(kg K)", 4180.0, 500.0, 5000.0, "fixed", "water at 30 degC, IAPWS-95"),
        )

    def problem(self, values: Mapping[str, float]) -> str | None:
        if self.follows_temperature:
            return "a fluid follows an input column; a temperature can only switch it (form 'threshold')"
        return super().problem(values)

    def emit(self, n: Names) -> Fragment:
        if self.absent(n):
            return Fragment()
        mcp = n.local("mcp")
        parts = self.parts(n)
        capacity_flow = (mcp, f"max({n.local('value')}, 0.0) * {n.par('cp')}")
        heat = {self.node: f"{mcp} * ({n.par('temperature')} - {n.temperature(self.node)})"}
        return Fragment(
            sample=(*parts.sample, capacity_flow), heat=heat, conductance={self.node: mcp}, memories=parts.memories
        )
