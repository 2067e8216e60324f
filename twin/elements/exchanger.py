"""Heat exchanger between two flow paths, in counterflow, with films that follow the flows.

    1/UA = (1 - film)/UA_100 + film/UA_100 (film_from f_a^-n + (1 - film_from) f_b^-n)        n = film_exponent
    form "counterflow"     Q = K (T_in,a - T_in,b),   1/K = min(1/C_a, 1/C_b) + g(y)/UA
                           y = UA |1/C_a - 1/C_b|,    g(y) = y / (1 - exp(-y))
    form "outlet"          Q = UA (T_a - T_b)

f is a flow as a share of its nominal one: that of the pump's speed, times the factor of the flow path. C = m cp, and
T_in is the water as it arrives at a side; T_a and T_b are the nodes' temperatures, with which it leaves.

K is the effectiveness times the smaller capacity rate, eps = (1 - exp(-NTU (1 - C_r))) / (1 - C_r exp(-NTU (1 - C_r))),
written without a gap where both rates are equal. In counterflow the colder water may leave warmer than the hotter one,
which no conduction between the two outlets can say.

Sources: effectiveness of a counterflow exchanger (Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., eq.
11.29a); resistances in series (ibid., eq. 11.1); films with the power of the flow, 0.8 in turbulent tubes (ibid., eq.
8.60) and 0.6 to 0.8 between corrugated plates (Shah and Sekulic, Fundamentals of Heat Exchanger Design, 2003, sec.
7.4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Export, Fragment

LEAST_SHARE = 1.0e-3
"""Flow below which a film stays as at this one, as a share of the nominal flow: the power of no flow is finite."""
LEAST_RATE = 1.0e-3
"""Least heat capacity rate, W/K: no flow at all carries no heat, without a division by zero."""
LEAST_APART = 1.0e-6
"""Least y of g(y), which is 1 at 0."""


@dataclass(frozen=True)
class Exchanger(Element):
    """Heat exchanger between the water of two flow paths."""

    kind: ClassVar[str] = "exchanger"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("UA_100", "W/K", None, 0.0, 1.0e6, "tunable", "conductance at both nominal flows, data sheet"),
        ParameterSpec("film", "1", 0.9, 0.0, 1.0, "fixed", "share of the resistance in both films"),
        ParameterSpec("film_from", "1", 0.5, 0.0, 1.0, "fixed", "share of that on the side `from`"),
        ParameterSpec(
            "film_exponent", "1", 0.7, 0.0, 1.0, "fixed", "of a film in its flow: plates 0.6 to 0.8, tubes 0.8"
        ),
    )

    a: str = place("node", "node of the first flow path, where its water leaves the exchanger", key="from")
    b: str = place("node", "node of the second flow path, where its water leaves the exchanger", key="to")
    form: str = place("choice", "law of the heat", choices=("counterflow", "outlet"), default="counterflow")

    def problem(self, values: Mapping[str, float]) -> str | None:
        return "both ends are the same node" if self.a == self.b else None

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where = ("coupling", sites.places[self.b])
        now = {spec.name: sites.values[f"{self.name}.{spec.name}"] for spec in self.parameters}
        full = now["UA_100"]

        def share(name: str, says: str) -> Candidate:
            size = EffectSize("1", 0.1, -now[name], 1.0 - now[name])
            return self.parameter_candidate(name, *where, "pump_speed", size, says)

        return (
            self.parameter_candidate(
                "UA_100",
                *where,
                "temperature_difference",
                EffectSize("W/K", 0.05 * full, -0.95 * full, 3.0 * full),
                f"exchanges heat with {self.a}, {{value}} more than when commissioned",
            ),
            share("film", f"exchanges heat with {self.a} with films whose share differs by {{value}}"),
            share("film_from", f"exchanges heat with {self.a} with a film there whose share differs by {{value}}"),
            share("film_exponent", f"exchanges heat with {self.a} with the flow by a power that differs by {{value}}"),
        )

    def emit(self, n: Names) -> Fragment:
        ua, bare, exponent = n.local("UA"), n.local("resistance"), n.par("film_exponent")
        flows = {side: n.of(n.streams[node].flow) for side, node in (("a", self.a), ("b", self.b))}
        sample = []
        for side, flow in flows.items():
            share = f"max({flow.local('q')} * 60.0 / {flow.par('nominal')}, {LEAST_SHARE})"
            sample.append((n.local(f"film_{side}"), f"exp(-{exponent} * log({share}))"))
        of_a, film = n.par("film_from"), n.par("film")
        films = f"{of_a} * {n.local('film_a')} + (1.0 - {of_a}) * {n.local('film_b')}"
        sample += [
            (bare, f"1.0 - {film} + {film} * ({films})"),
            (ua, f"{n.par('UA_100')} / {bare}"),
        ]
        stage: tuple[tuple[str, str], ...] = ()
        if self.form == "outlet":
            rate, warm, cold = ua, n.temperature(self.a), n.temperature(self.b)
        else:
            rate, warm, cold = n.local("rate"), n.local("arriving_a"), n.local("arriving_b")
            sample += _counterflow(n, ua, flows["a"].local("mcp"), flows["b"].local("mcp"), rate)
            sides = ((warm, self.a, flows["a"]), (cold, self.b, flows["b"]))
            stage = tuple((name, _arriving(n, node, flow)) for name, node, flow in sides)
        q = n.local("heat")
        return Fragment(
            sample=tuple(sample),
            stage=(*stage, (q, f"{rate} * ({warm} - {cold})")),
            heat={self.a: f"-{q}", self.b: q},
            conductance={self.a: rate, self.b: rate},
            exports={"heat": Export("W", q)},
        )


def _arriving(n: Names, node: str, flow: Names) -> str:
    """Return the temperature of the water that arrives at a node; its flow has share * (that - T) as a local name."""
    return f"{n.temperature(node)} + {flow.local(f'd_{node}')} * (1.0 / {flow.par(f'effectiveness_{node}')})"


def _counterflow(n: Names, ua: str, a: str, b: str, rate: str) -> list[tuple[str, str]]:
    """Return expressions of eps * C_min, W/K, into the local name `rate`, for two heat capacity rates in W/K."""
    per_a, per_b, most, apart = (n.local(name) for name in ("per_a", "per_b", "per_most", "apart"))
    return [
        (per_a, f"1.0 / max({a}, {LEAST_RATE})"),
        (per_b, f"1.0 / max({b}, {LEAST_RATE})"),
        (most, f"min({per_a}, {per_b})"),
        (apart, f"max({ua} * (max({per_a}, {per_b}) - {most}), {LEAST_APART})"),
        (rate, f"{ua} / ({ua} * {most} + {apart} / (1.0 - exp(-{apart})))"),
    ]
