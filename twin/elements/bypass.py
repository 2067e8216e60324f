"""Bypass: water that takes a short cut past nodes of a flow path.

    fraction * m cp * (w_in - T_j)  no longer goes into each skipped node j;
    their sum goes into the node where the streams meet again

Source: heat balance of a mixing tee (Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., eq. 1.12e), exact
for nodes that the water leaves well mixed (flow effectiveness 1, the default). Written as a correction of the flow path
on which the nodes stand. Its parts add up to zero: heat is only rearranged. Past a single node it is the same as a flow
effectiveness of 1 - fraction there. Past the last node of an open path the skipped heat leaves with the water.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment


@dataclass(frozen=True)
class Bypass(Element):
    """A share of a loop's flow that skips one node or several in a row; there is none at fraction 0."""

    kind: ClassVar[str] = "bypass"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("fraction", "1", 0.0, 0.0, 1.0, "tunable", "leaking valve or short cut; zero in a healthy loop"),
    )

    around: tuple[str, ...] = place("nodes", "nodes that are skipped, in the order of the flow path")

    def problem(self, values: Mapping[str, float]) -> str | None:
        return "a node is named twice" if len(set(self.around)) != len(self.around) else None

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {e.around for e in sites.having(cls.kind)}
        around: list[tuple[str, tuple[str, ...]]] = [(sites.places[node], (node,)) for node in sites.before]
        around += [(place, group) for place, group in sites.groups.items() if all(n in sites.before for n in group)]
        return tuple(
            Candidate(
                "flow",
                place,
                "constant",
                "new",
                {f"{name}.fraction": 1.0},
                "of the flow",
                0.05,
                0.0,
                1.0,
                "is bypassed by {value}",
                adds={name: {"kind": cls.kind, "around": list(nodes)}},
                exhausts=True,
                total_loss=1.0,
            )
            for place, nodes in around
            if nodes not in having and (name := f"bypass_of_{nodes[0]}" if len(nodes) == 1 else f"bypass_of_{place}")
        )

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        places = {nodes: place for place, nodes in sites.groups.items()}
        where = places.get(self.around, sites.places[self.around[0]])
        now = sites.values[f"{self.name}.fraction"]
        says = "is bypassed by another share of the flow: a change by {value}" if now else "is bypassed by {value}"
        fraction = self.parameter_candidate(
            "fraction", "flow", where, "constant", EffectSize("of the flow", 0.05, -now, 1.0 - now), says
        )
        fraction = replace(fraction, exhausts=True, total_loss=1.0 - now)
        return (fraction if now else replace(fraction, change="new"),)

    def emit(self, n: Names) -> Fragment:
        if n.constant("fraction") == 0.0:
            return Fragment()
        flow = n.streams[self.around[0]].flow
        skipped = {node: n.local(f"skipped_{node}") for node in self.around}
        stage = tuple(
            (name, f"{n.par('fraction')} * {n.local('mcp', flow)} * {n.local(f'd_{node}', flow)}")
            for node, name in skipped.items()
        )
        heat = {node: f"-{name}" for node, name in skipped.items()}
        after = [node for node, stream in n.streams.items() if stream.before == self.around[-1]]
        if after and after[0] not in self.around:
            heat[after[0]] = " + ".join(skipped.values())
        # The flow counts the whole m cp at every skipped node already, so no conductance is added.
        return Fragment(stage=stage, heat=heat)
