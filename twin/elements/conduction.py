"""Heat conducted between two nodes: Q = (T_a - T_b) / R.

Source: the resistance term of eq. 1 of Energies 2026, 19, 2452. The lower bound of R keeps the smallest time
constant of a network finite; below it two nodes are one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment


@dataclass(frozen=True)
class Conduction(Element):
    """A thermal resistance between two nodes."""

    kind: ClassVar[str] = "conduction"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("resistance", "K/W", None, 2.0e-4, 1.0e6, "tunable", "effective resistance between the two"),
    )

    a: str = place("node", "one end", key="from")
    b: str = place("node", "the other end", key="to")

    def problem(self, values: Mapping[str, float]) -> str | None:
        return "both ends are the same node" if self.a == self.b else None

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {frozenset((e.a, e.b)) for e in sites.having(cls.kind)}
        return tuple(
            Candidate(
                "coupling",
                sites.places[b],
                "temperature_difference",
                "new",
                {f"{name}.resistance": 1.0},
                "W/K",
                1.0,
                0.0,
                1.0 / cls.parameters[0].lower,  # of the resistance
                f"exchanges heat with {a}, {{value}}",
                adds={name: {"kind": cls.kind, "from": a, "to": b}},
                inverse=True,
            )
            for i, a in enumerate(sites.nodes)
            for b in sites.nodes[i + 1 :]
            if frozenset((a, b)) not in having and (name := f"bridge_from_{a}_to_{b}")
        )

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        now = sites.values[f"{self.name}.resistance"]
        says = f"has {{value}} more resistance to {self.a} than when commissioned"
        return (
            self.parameter_candidate(
                "resistance",
                "coupling",
                sites.places[self.b],
                "temperature_difference",
                EffectSize("K/W", 0.1 * now, -0.9 * now, 20.0 * now),
                says,
            ),
        )

    def emit(self, n: Names) -> Fragment:
        g, q = n.local("g"), n.local("q")
        return Fragment(
            sample=((g, f"1.0 / {n.par('resistance')}"),),
            stage=((q, f"{g} * ({n.temperature(self.a)} - {n.temperature(self.b)})"),),
            heat={self.a: f"-{q}", self.b: q},
            conductance={self.a: g, self.b: g},
        )
