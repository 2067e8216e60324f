"""Coolant flow along a path of nodes, which closes by itself unless an inlet is given.

    q = nominal * pump/100 * factor / 60             L/s, and the change that a `law_flow` may name
    m cp = q * density * cp                          W/K
    heat into node j = a_j * m cp * (w_in - T_j)
    water leaving j:  w_j = w_in - a_j * (w_in - T_j)        (outlet = "exchanged")
                      w_j = T_j                              (outlet = "volume")

``a_j`` is the share of the way to equilibrium that the water makes in node j. It is the same at every flow, except in
the nodes of `film`. There it is the share at full speed, and a film between water and solid makes it follow the flow,

    a_j = 1 - exp(-NTU_j),   NTU_j = -log(1 - effectiveness_j) (pump/100)^(film_exponent - 1)

as for a wall of one temperature (Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., eqs. 8.41b, 11.35a). At
a_j = 1 (well mixed) both outlets are the advective term of eq. 1 of Energies 2026, 19, 2452. Its Table 1 multiplies
that term by a flow factor at the modules and keeps T_j as the inlet of the next volume ("volume"). For a_j other than 1
this creates heat from nothing, m cp (a_j - 1)(w_in - T_j). "exchanged" hands on the remainder, so that the heat is
conserved for every a_j, and it is the default.

Between 0 and 2 each node passes on at most the change that it receives, |w_j / w_in| <= 1 at every frequency. So the
ring is stable; beyond 2 it is not, hence the bounds.

A closed path in which no node is well mixed is solved for the returning water, w_0 = P w_0 + r with P the product of
the stations' transmission. With an inlet (a column with the temperature of the incoming water) the path is open and
the water that leaves the last node is gone.

A pipe before a node takes the water leaving the node before (`to_<node>`) and returns ``through * water + rest``; see
`pipe`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Export, Fragment

WATER_DENSITY = 0.997
"""kg/L at 25 degC (IAPWS-95)."""
LEAST_PERCENT = 0.1
"""Pump speed below which a film stays as at this one, %: the power of a pump at rest is finite."""
FILM_EXPONENT = ParameterSpec(
    "film_exponent", "1", 0.4, 0.0, 1.0, "fixed", "of hA in the flow: 0 laminar, 0.8 turbulent (Incropera 8.4, 8.5)"
)


@dataclass(frozen=True)
class Flow(Element):
    """Advective path with a pump law proportional to speed."""

    kind: ClassVar[str] = "flow"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("nominal", "L/min", None, 0.01, 1000.0, "boundary", "flow at 100 % pump speed, data sheet"),
        ParameterSpec("factor", "1", 1.0, 0.2, 3.0, "tunable", "true flow over nominal flow"),
        ParameterSpec("cp", "J/(kg K)", 4180.0, 1000.0, 5000.0, "fixed", "water at 30 degC, IAPWS-95"),
    )

    path: tuple[str, ...] = place("nodes", "nodes in the order in which the water meets them; it closes by itself")
    pump: str = place("input", "input column with the pump speed in %", unit="%")
    film: tuple[str, ...] = place("nodes", "nodes of the path whose effectiveness depends on the flow", default=())
    outlet: str = place(
        "choice", "temperature with which water leaves a node", choices=("exchanged", "volume"), default="exchanged"
    )
    inlet: str = place("input", "input column with the temperature of the water that comes in", unit="degC", default="")

    def nodes(self) -> tuple[str, ...]:
        return self.path

    def inputs(self) -> tuple[str, ...]:
        return (self.pump, self.inlet) if self.inlet else (self.pump,)

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        source = "share of the way to equilibrium that the water goes"
        stations = tuple(
            ParameterSpec(f"effectiveness_{node}", "1", 1.0, 0.05, 1.95, "fixed", source)
            if node not in self.film
            else ParameterSpec(
                f"effectiveness_{node}", "1", None, 0.01, 0.99, "fixed", "1 - exp(-hA / m cp), full speed"
            )
            for node in self.path
        )
        return self.parameters + stations + ((FILM_EXPONENT,) if self.film else ())

    def feeds(self) -> Mapping[str, str]:
        before = ("" if self.inlet else self.path[-1], *self.path[:-1])
        return dict(zip(self.path, before, strict=True))

    def problem(self, values: Mapping[str, float]) -> str | None:
        if len(set(self.path)) != len(self.path) or (len(self.path) < 2 and not self.inlet):
            return (
                "the flow path must name at least two different nodes, each once; the loop closes by itself, and a "
                "path of one node needs an inlet"
            )
        strangers = [node for node in self.film if node not in self.path]
        if strangers:
            return f"node {strangers[0]!r} has a film but is not on the path"
        return None

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        now, (first, *_) = sites.values[f"{self.name}.factor"], sites.having(self.kind)
        candidate = self.parameter_candidate(
            "factor",
            "flow",
            "loop" if first.name == self.name else self.name,
            "constant",
            EffectSize("of the nominal flow", 0.03, -now, 1.0),
            "carries {value} more than when commissioned",
        )
        return (replace(candidate, total_loss=-now),)

    def emit(self, n: Names) -> Fragment:
        flow, mcp = n.local("q"), n.local("mcp")
        litres = f"{n.par('nominal')} / 60.0 * {n.par('factor')} * max({n.input(self.pump)} * 0.01, 0.0)"
        for change in n.changed_by():
            litres = change.format(flow=f"({litres})")
        sample = [
            (flow, litres),
            (mcp, f"{flow} * {WATER_DENSITY!r} * {n.par('cp')}"),
        ]
        mixed = {node: n.constant(f"effectiveness_{node}") == 1.0 for node in self.path}
        share = {node: "1.0" if mixed[node] else n.par(f"effectiveness_{node}") for node in self.path}
        uniform: tuple[tuple[str, str], ...] = ()
        if self.film:
            log_pump, slower = n.local("log_pump"), n.local("slower")
            uniform = ((log_pump, f"log(max({n.input(self.pump)}, {LEAST_PERCENT}) * 0.01)"),)
            sample.append((slower, f"exp(({n.par('film_exponent')} - 1.0) * {log_pump})"))
            for node in self.film:
                full, share[node] = share[node], n.local(f"share_{node}")
                sample.append((share[node], f"1.0 - exp(log(1.0 - {full}) * {slower})"))
        handed_on = {node: self.outlet == "volume" or mixed[node] for node in self.path}
        path, stage = self.path, []
        closed_by = [k for k, node in enumerate(path) if handed_on[node]]
        if self.inlet:
            water = n.input(self.inlet)
        elif closed_by:
            path = path[closed_by[-1] + 1 :] + path[: closed_by[-1] + 1]
            water = n.temperature(path[-1])
        else:
            water = n.local("w0")
            sample.append((n.local("ring"), f"1.0 / (1.0 - {_let_through(n, share)})"))
            stage.append((water, f"{_once_around(n, share)} * {n.local('ring')}"))
        heat: dict[str, str] = {}
        for node in path:
            stream = n.streams.get(node)
            if stream and stream.pipe:
                stage.append((n.local(f"to_{node}"), water))
                water = _arriving(n, stream.pipe, n.local(f"to_{node}"))
            gain, left = n.local(f"d_{node}"), n.local(f"w_{node}")
            stage.append((gain, f"{share[node]} * (({water}) - {n.temperature(node)})"))
            heat[node] = f"{mcp} * {gain}"
            if handed_on[node]:
                water = n.temperature(node)
            else:
                stage.append((left, f"({water}) - {gain}"))
                water = left
        return Fragment(
            uniform=uniform,
            sample=tuple(sample),
            stage=tuple(stage),
            heat=heat,
            conductance={node: f"{mcp} * {share[node]}" for node in self.path},
            exports={"mass_flow": Export("kg/s", f"{flow} * {WATER_DENSITY!r}")},
        )


def _arriving(n: Names, pipe: str, water: str) -> str:
    return f"({n.local('through', pipe)} * ({water}) + {n.local('rest', pipe)})"


def _let_through(n: Names, share: Mapping[str, str]) -> str:
    """Return the share of a change of the water that comes round again; the bounds keep it well below 1."""
    factors = [f"(1.0 - {a})" for a in share.values()]
    factors += [n.local("through", s.pipe) for s in (n.streams.get(node) for node in share) if s and s.pipe]
    return " * ".join(factors)


def _once_around(n: Names, share: Mapping[str, str]) -> str:
    """Return the water temperature after one turn that began at 0."""
    turn = "0.0"
    for node, a in share.items():
        stream = n.streams.get(node)
        if stream and stream.pipe:
            turn = _arriving(n, stream.pipe, turn)
        turn = f"(({turn}) * (1.0 - {a}) + {a} * {n.temperature(node)})"
    return turn
