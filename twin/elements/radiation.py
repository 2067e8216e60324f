"""Thermal radiation from a node to the room or to another node.

    Q = emissivity * sigma * area * (T^4 - T_other^4)        temperatures in kelvin

Source: Stefan-Boltzmann law for a small grey body in large surroundings (Incropera, Fundamentals of Heat and
Mass Transfer, 7th ed., eq. 1.7); between two nodes `emissivity` is the grey-body exchange factor of the pair,
which holds the view factor (ibid., eq. 13.18). The fourth powers are written as (a - b)(a + b)(a^2 + b^2), which
keeps the digits of a small difference.

A temperature counts as at most 727 degC: far above any liquid loop, and finite in a runaway. The step is chosen for
200 degC; the integrator's margin covers the rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment

STEFAN_BOLTZMANN = 5.670374419e-8
"""W/(m2 K4), CODATA 2018."""
CELSIUS = 273.15
HOTTEST_C = 727.0
_BOUND = 4.0 * STEFAN_BOLTZMANN * 473.15**3


@dataclass(frozen=True)
class Radiation(Element):
    """Fourth-power exchange with the room (`ambient`) or with another node (`to`); there is none at area 0."""

    kind: ClassVar[str] = "radiation"
    linear: ClassVar[bool] = False
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("area", "m2", None, 0.0, 100.0, "fixed", "radiating surface, from the drawing"),
        ParameterSpec("emissivity", "1", 0.9, 0.0, 1.0, "fixed", "painted or oxidised surface, Incropera table A.11"),
    )

    node: str = place("node", "node that radiates")
    to: str = place("node", "node on the other side, left out for the room", default="")
    ambient: str = place(
        "input", "input column with the temperature of the surroundings in degC", unit="degC", default=""
    )

    def nodes(self) -> tuple[str, ...]:
        return (self.node, self.to) if self.to else (self.node,)

    def inputs(self) -> tuple[str, ...]:
        return (self.ambient,) if self.ambient else ()

    def problem(self, values: Mapping[str, float]) -> str | None:
        if bool(self.to) == bool(self.ambient):
            return "give either `to`, another node, or `ambient`, the input with the temperature of the surroundings"
        return "both sides are the same node" if self.to == self.node else None

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {e.node for e in sites.having(cls.kind)}
        return tuple(
            Candidate(
                "heat_loss",
                sites.places[node],
                "temperature",
                "new",
                {f"{name}.area": 1.0},
                "m2",
                0.1,
                0.0,
                cls.upper_of("area"),
                "radiates to the room from {value}",
                adds={name: {"kind": cls.kind, "node": node, "ambient": sites.room}},
            )
            for node in sites.nodes
            if sites.room and node not in having and (name := f"radiation_of_{node}")
        )

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where, now = sites.places[self.node], sites.values[f"{self.name}.area"]
        kind, other = ("coupling", self.to) if self.to else ("heat_loss", "the room")
        says = f"radiates to {other} from {{value}} more than when commissioned"
        return (
            self.parameter_candidate(
                "area", kind, where, "temperature", EffectSize("m2", 0.1, -now, self.upper_of("area") - now), says
            ),
        )

    def emit(self, n: Names) -> Fragment:
        a, b, q, g = n.local("a"), n.local("b"), n.local("q"), n.local("g")
        other = n.temperature(self.to) if self.to else n.input(self.ambient)
        strength = f"{n.par('emissivity')} * {n.par('area')}"
        heat = f"{STEFAN_BOLTZMANN!r} * {g} * ({a} - {b}) * ({a} + {b}) * ({a} * {a} + {b} * {b})"
        bound = f"{_BOUND!r} * {g}"
        return Fragment(
            sample=((g, strength),),
            stage=((a, _kelvin(n.temperature(self.node))), (b, _kelvin(other)), (q, heat)),
            heat={self.node: f"-{q}", self.to: q} if self.to else {self.node: f"-{q}"},
            conductance=dict.fromkeys(self.nodes(), bound),
        )


def _kelvin(celsius: str) -> str:
    return f"min(max({celsius}, {-CELSIUS}), {HOTTEST_C}) + {CELSIUS}"
