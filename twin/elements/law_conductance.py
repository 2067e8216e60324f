"""Law of a conductance: value (T_other - T) between a node and another, or an input column.

Driver, form and time course of the value, and the source of its balance: `law`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Names, place
from twin.elements.candidates import Candidate, Sites
from twin.elements.fragments import Fragment
from twin.elements.law import LIMITS, Law, with_heat


@dataclass(frozen=True)
class LawConductance(Law):
    """Conductance, or the change of one, between a node and another node or an input column."""

    kind: ClassVar[str] = "law_conductance"
    linear: ClassVar[bool] = False
    unit: ClassVar[str] = "W/K"
    most: ClassVar[float] = 1.0e4

    node: str = place("node", "node that exchanges heat")
    to: str = place("node", "node on the other side", default="")
    ambient: str = place(
        "input", "input column with the temperature on the other side instead", unit="degC", default=""
    )

    def own_nodes(self) -> tuple[str, ...]:
        return (self.node, self.to)

    def own_inputs(self) -> tuple[str, ...]:
        return (self.ambient,)

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        name = f"{self.name}.{self.strength}"
        now, other = sites.values[name], self.to or self.ambient
        if now == 0.0 or self.course != "always":
            return ()
        kind = "coupling" if self.to else "heat_loss" if other == sites.room else "heat_rejection"
        return (
            Candidate(
                kind,
                sites.places[self.node],
                "temperature_difference",
                "existing",
                {name: now},
                *("of the conductance", 0.05, -0.95, 3.0),
                f"has {{value}} more to {other} than when commissioned",
            ),
        )

    def problem(self, values: Mapping[str, float]) -> str | None:
        if bool(self.to) == bool(self.ambient):
            return "give either a node (to) or an input column (ambient) for the other side"
        if self.to == self.node:
            return "both sides are the same node"
        return super().problem(values)

    def emit(self, n: Names) -> Fragment:
        if self.absent(n):
            return Fragment()
        parts, g, most, q = self.parts(n), n.local("value"), LIMITS["W"], n.local("q")
        away = n.temperature(self.to) if self.to else n.input(self.ambient)
        # A negative conductance feeds itself: it needs a limit.
        exchange = (q, f"min(max({g} * ({away} - {n.temperature(self.node)}), -{most!r}), {most!r})")
        bound = n.local("bound")
        largest = (
            f"min({n.local('slope')} * 200.0, {LIMITS['W/K']!r})" if self.follows_temperature else f"max({g}, -{g})"
        )
        heat = {self.node: q} | ({self.to: f"-{q}"} if self.to else {})
        more = Fragment(
            sample=(*parts.sample, (bound, largest)),
            stage=(*parts.stage, exchange),
            states=parts.states,
            memories=parts.memories,
        )
        return with_heat(more, heat, dict.fromkeys(heat, bound))
