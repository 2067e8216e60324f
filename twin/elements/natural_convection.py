"""Heat lost to the room by natural convection, a power law of the temperature difference.

    Q = coefficient * |T - T_amb|^exponent * sign(T - T_amb)

Source: Nu = C (Gr Pr)^n makes h grow as the difference to the power n, so `exponent` is 1 + n: 1.25 for laminar,
1.33 for turbulent layers (Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., sec. 9.6.1; McAdams, Heat
Transmission, 3rd ed., ch. 7). `coefficient` is the loss at a difference of 1 K.

Written as (dT^2 + 1e-4)^((exponent - 1) / 2) * dT: smooth through zero, where the power law has an infinite second
derivative, and within 0.1 % of it from a difference of 0.2 K on. A linear loss is `ambient_loss`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment

SMOOTH_K2 = 1.0e-4
LARGEST_K = 1000.0
_BOUND_K = 200.0


@dataclass(frozen=True)
class NaturalConvection(Element):
    """A loss that grows faster than the temperature difference; there is none at coefficient 0."""

    kind: ClassVar[str] = "natural_convection"
    linear: ClassVar[bool] = False
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("coefficient", "W/K^n", None, 0.0, 500.0, "tunable", "loss at a difference of 1 K"),
        ParameterSpec("exponent", "1", 1.25, 1.0, 1.5, "fixed", "1.25 laminar, 1.33 turbulent, McAdams ch. 7"),
    )

    node: str = place("node", "node that loses the heat")
    ambient: str = place("input", "input column with the room temperature in degC", unit="degC", default="T_ambient_C")

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {e.node for e in sites.having(cls.kind)}
        return tuple(
            Candidate(
                "heat_loss",
                sites.places[node],
                "temperature",
                "new",
                {f"{name}.coefficient": 1.0},
                "W/K^1.25",
                0.5,
                0.0,
                cls.upper_of("coefficient"),
                "loses heat to the room by natural convection, {value}",
                adds={name: {"kind": cls.kind, "node": node, "ambient": sites.room}},
            )
            for node in sites.nodes
            if sites.room and node not in having and (name := f"convection_of_{node}")
        )

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where, now = sites.places[self.node], sites.values[f"{self.name}.coefficient"]
        says = "loses heat to the room by natural convection, {value} more than when commissioned"
        return (
            self.parameter_candidate(
                "coefficient",
                "heat_loss",
                where,
                "temperature",
                EffectSize("W/K^1.25", 0.5, -now, self.upper_of("coefficient") - now),
                says,
            ),
        )

    def emit(self, n: Names) -> Fragment:
        d, q, g = n.local("d"), n.local("q"), n.local("g")
        power = f"0.5 * ({n.par('exponent')} - 1.0)"
        difference = f"min(max({n.input(self.ambient)} - {n.temperature(self.node)}, -{LARGEST_K}), {LARGEST_K})"
        heat = f"{n.par('coefficient')} * {d} * exp({power} * log({d} * {d} + {SMOOTH_K2!r}))"
        slope = f"{n.par('coefficient')} * {n.par('exponent')} * exp({power} * {2.0 * math.log(_BOUND_K)!r})"
        return Fragment(
            sample=((g, slope),),
            stage=((d, difference), (q, heat)),
            heat={self.node: q},
            conductance={self.node: g},
        )
