"""Coolant pumped around a closed path of nodes.

    m = nominal * pump/100 * factor
    heat into node j = a_j * m * cp * (w_in - T_j)
    water leaving j:  w_j = w_in - a_j * (w_in - T_j)        (outlet = "exchanged")
                      w_j = T_j                              (outlet = "volume")

``a_j`` is the share of the way to equilibrium that the water makes in node j. At a_j = 1 (well mixed) both
outlets are the advective term of eq. 1 of Energies 2026, 19, 2452. Its Table 1 multiplies that term by a flow
factor at the modules and keeps T_j as the inlet of the next volume ("volume"): for a_j other than 1 that
creates heat from nothing, m cp (a_j - 1)(w_in - T_j). "exchanged" hands on what is left, so that the heat is
conserved for every a_j, and it is the default.

Between 0 and 2 each node passes on at most what it gets, |w_j / w_in| <= 1 at every frequency, so the ring is
stable; beyond 2 it is not, hence the bounds.

The path is a ring, so the water temperatures solve w_0 = P w_0 + r with P the product of (1 - a_j): one
division per sample interval.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place

WATER_DENSITY = 0.997
"""kg/L at 25 degC (IAPWS-95)."""


@dataclass(frozen=True)
class Flow(Element):
    """An advective loop with a pump law proportional to speed."""

    kind: ClassVar[str] = "flow"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("nominal", "L/min", None, 0.01, 1000.0, "boundary", "flow at 100 % pump speed, data sheet"),
        ParameterSpec("factor", "1", 1.0, 0.2, 3.0, "tunable", "true flow over nominal flow"),
        ParameterSpec("cp", "J/(kg K)", 4180.0, 1000.0, 5000.0, "fixed", "water at 30 degC, IAPWS-95"),
    )

    path: tuple[str, ...] = place("nodes", "nodes in the order in which the water meets them; it closes by itself")
    pump: str = place("input", "input column with the pump speed in %")
    outlet: str = place("choice", "what leaves a node", choices=("exchanged", "volume"), default="exchanged")

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        source = "coolant flow factor of Table 1, as the share of the way to equilibrium"
        stations = tuple(
            ParameterSpec(f"effectiveness_{node}", "1", 1.0, 0.05, 1.95, "fixed", source) for node in self.path
        )
        return self.parameters + stations

    def problem(self, values: Mapping[str, float]) -> str | None:
        if len(self.path) < 2 or len(set(self.path)) != len(self.path):
            return "the flow path must name at least two different nodes, each once; the loop closes by itself"
        return None

    def emit(self, n: Names) -> Fragment:
        mcp = n.local("mcp")
        sample = [
            (
                mcp,
                f"{n.par('nominal')} * {WATER_DENSITY / 60.0!r} * {n.par('factor')} * {n.par('cp')}"
                f" * max({n.input(self.pump)} * 0.01, 0.0)",
            )
        ]
        mixed = {node: n.constant(f"effectiveness_{node}") == 1.0 for node in self.path}
        share = {node: "1.0" if mixed[node] else n.par(f"effectiveness_{node}") for node in self.path}
        last = self.path[-1]
        stage: list[tuple[str, str]] = []
        if self.outlet == "volume" or mixed[last]:
            inlet = n.temperature(last)
        else:
            inlet = n.local("w0")
            sample.append((n.local("ring"), _ring(share)))
            stage.append((inlet, f"{_once_around(n, share)} * {n.local('ring')}"))
        heat: dict[str, str] = {}
        for k, node in enumerate(self.path, start=1):
            gain = n.local(f"d{k}")
            difference = f"{inlet} - {n.temperature(node)}"
            stage.append((gain, difference if mixed[node] else f"{share[node]} * ({difference})"))
            heat[node] = f"{mcp} * {gain}"
            if self.outlet == "volume" or mixed[node]:
                inlet = n.temperature(node)
            elif node != last:
                stage.append((n.local(f"w{k}"), f"{inlet} - {gain}"))
                inlet = n.local(f"w{k}")
        return Fragment(
            sample=tuple(sample),
            stage=tuple(stage),
            heat=heat,
            conductance={node: f"{mcp} * {share[node]}" for node in self.path},
        )


def _ring(share: Mapping[str, str]) -> str:
    """1 / (1 - product of (1 - a)); the bounds of a keep the product well below 1."""
    return f"1.0 / (1.0 - {' * '.join(f'(1.0 - {a})' for a in share.values())})"


def _once_around(n: Names, share: Mapping[str, str]) -> str:
    """Water temperature after one turn that began at 0."""
    turn = "0.0"
    for node, a in share.items():
        turn = n.temperature(node) if a == "1.0" else f"(({turn}) * (1.0 - {a}) + {a} * {n.temperature(node)})"
    return turn
