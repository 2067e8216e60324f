"""Heat conducted between two nodes: Q = (T_a - T_b) / R.

Source: the resistance term of eq. 1 of Energies 2026, 19, 2452. The lower bound of R keeps the smallest time
constant of a network finite; below it two nodes are one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place


@dataclass(frozen=True)
class Conduction(Element):
    """A thermal resistance between two nodes."""

    kind: ClassVar[str] = "conduction"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("resistance", "K/W", None, 2.0e-3, 1.0e4, "tunable", "effective, Table 1 of the paper"),
    )

    a: str = place("node", "one end", key="from")
    b: str = place("node", "the other end", key="to")

    def problem(self, values: Mapping[str, float]) -> str | None:
        return "both ends are the same node" if self.a == self.b else None

    def emit(self, n: Names) -> Fragment:
        g, q = n.local("g"), n.local("q")
        return Fragment(
            sample=((g, f"1.0 / {n.par('resistance')}"),),
            stage=((q, f"{g} * ({n.temperature(self.a)} - {n.temperature(self.b)})"),),
            heat={self.a: f"-{q}", self.b: q},
            conductance={self.a: g, self.b: g},
        )
