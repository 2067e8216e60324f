"""Lumped mass: the only kind that stores heat.

    C dT/dt = sum of the heat flows into the node

Source: left side of eq. 1 of Energies 2026, 19, 2452; C is the "effective thermal capacitance" of its Table 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment


@dataclass(frozen=True)
class Node(Element):
    """A volume at one temperature, named like the element itself."""

    kind: ClassVar[str] = "node"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("capacitance", "J/K", None, 1.0, 1.0e9, "fixed", "mass times specific heat of water and solid"),
    )

    def nodes(self) -> tuple[str, ...]:
        return (self.name,)

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        now = sites.values[f"{self.name}.capacitance"]
        says = "has {value} more thermal mass than when commissioned"
        return (
            self.parameter_candidate(
                "capacitance",
                "thermal_mass",
                sites.places[self.name],
                "history",
                EffectSize("J/K", 0.1 * now, -0.8 * now, 5.0 * now),
                says,
            ),
        )

    def emit(self, n: Names) -> Fragment:
        return Fragment()
