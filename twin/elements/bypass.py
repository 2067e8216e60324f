"""Water that takes a short cut past nodes of a flow path.

    q_j = fraction * m cp * (T_(j-1) - T_j) no longer goes into each skipped node j,
    fraction * m cp * (T_before - T_last) goes into the node where the streams meet again

Source: heat balance of a mixing tee (Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., eq. 1.12e). Written
as a correction of the flow element that it belongs to, whose m cp it uses, for nodes that the water leaves well mixed
(effectiveness 1, the default). Its parts add up to zero: heat is only rearranged. Past a single node it is the same
as a flow effectiveness of 1 - fraction there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place
from twin.elements.flow import WATER_DENSITY


@dataclass(frozen=True)
class Bypass(Element):
    """A share of a loop's flow that skips one node or several in a row; fraction 0 is none at all."""

    kind: ClassVar[str] = "bypass"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("fraction", "1", 0.0, 0.0, 0.9, "tunable", "leaking valve or short cut; zero in a healthy loop"),
    )

    flow: str = field(metadata={"role": "element", "about": "name of the flow element that the water is taken from"})
    before: str = place("node", "node that the water comes from")
    around: tuple[str, ...] = place("nodes", "nodes that are skipped, in the order of the flow path")
    after: str = place("node", "node where the short cut joins again")
    pump: str = place("input", "input column with the pump speed in %, as for the flow")

    def problem(self, values: Mapping[str, float]) -> str | None:
        if len(set(self.around)) != len(self.around) or {self.before, self.after} & set(self.around):
            return "the skipped nodes must differ from each other and from the nodes before and after them"
        return None

    def emit(self, n: Names) -> Fragment:
        loop, short = Names(self.flow), n.local("short")
        rate = (
            f"{n.par('fraction')} * {loop.par('nominal')} * {WATER_DENSITY / 60.0!r} * {loop.par('factor')}"
            f" * {loop.par('cp')} * max({n.input(self.pump)} * 0.01, 0.0)"
        )
        upstream = (self.before, *self.around[:-1])
        heat = {
            node: f"-{short} * ({n.temperature(inlet)} - {n.temperature(node)})"
            for inlet, node in zip(upstream, self.around, strict=True)
        }
        heat[self.after] = f"{short} * ({n.temperature(self.before)} - {n.temperature(self.around[-1])})"
        # The flow element already counts the whole m cp at every skipped node, so nothing is added there.
        return Fragment(sample=((short, rate),), heat=heat)
