"""Law of heat: value W into a node; with `source`, taken out of that node.

Driver, form and time course of the value, and the source of its balance: `law`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Names, place
from twin.elements.fragments import Fragment
from twin.elements.law import Law, with_heat


@dataclass(frozen=True)
class LawHeat(Law):
    """Heat into a node, from outside or out of another node."""

    kind: ClassVar[str] = "law_heat"
    linear: ClassVar[bool] = False
    unit: ClassVar[str] = "W"
    most: ClassVar[float] = 1.0e5
    total: ClassVar[tuple[str, float]] = ("J", 1.0e9)

    node: str = place("node", "node that receives the heat")
    source: str = place("node", "node out of which the heat is taken, left out for heat from outside", default="")

    def own_nodes(self) -> tuple[str, ...]:
        return (self.node, self.source)

    def problem(self, values: Mapping[str, float]) -> str | None:
        return "source names the node itself" if self.source == self.node else super().problem(values)

    def emit(self, n: Names) -> Fragment:
        if self.absent(n):
            return Fragment()
        parts, value = self.parts(n), n.local("value")
        heat = {self.node: value} | ({self.source: f"-{value}"} if self.source else {})
        own = {node: n.local("slope") for node in heat if self.follows_temperature and node in (self.of, self.minus)}
        return with_heat(parts, heat, own)
