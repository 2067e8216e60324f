"""Thermal mass without a sensor, behind a conductance at a node.

    C dT_h/dt = g (T - T_h),      heat into the node = -g (T - T_h)
    g = G C / (C + G LEAST_S)

It takes no part in a steady state and slows every change. With G = `conductance`, g is G in series with the mass's own
resistance LEAST_S / C, which keeps the time constant C / g above LEAST_S. With no capacity or no conductance there
is no effect. Source: the two-node lumped model (Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., sec. 5.1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import ElementState, Fragment

LEAST_S = 1.0
MOST_CAPACITY = 1.0e9
"""J/K."""
TIME_CONSTANTS_S = tuple(120.0 * 3.0 ** (k / 2.0) for k in range(10))
"""Capacity over conductance of candidate masses, s."""
PUT_IN_S = TIME_CONSTANTS_S[1::2]
"""Capacity over conductance of candidate masses that are inserted at the temperature of the room, s."""
MOST, SLOWEST_S, QUICKEST_S = 500.0, 200.0, 5.0
"""Largest conductance of such a mass, W/K, and the longest and shortest response time of the node beside it, s."""
LEAST_PUT_IN = 5.0
"""Least conductance of such a mass, W/K: that of a hand's breadth of metal in stirred water."""


@dataclass(frozen=True)
class HiddenMass(Element):
    """A capacity without a sensor that exchanges heat with one node."""

    kind: ClassVar[str] = "hidden_mass"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("capacity", "J/K", None, 0.0, MOST_CAPACITY, "tunable", "mass times specific heat"),
        ParameterSpec("conductance", "W/K", None, 0.0, 1.0e5, "tunable", "between the mass and the node"),
    )

    node: str = place("node", "node that the mass exchanges heat with")

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {e.node for e in sites.having(cls.kind)}
        bare = [(sites.places[node], node) for node in sites.nodes if node not in having]
        most = {node: _most(sites.values.get(f"{node}.capacitance", 0.0)) for _, node in bare}
        found = [_mass(where, node, "", most[node], tau) for where, node in bare for tau in TIME_CONSTANTS_S]
        if sites.room:
            found += [_mass(where, node, sites.room, most[node], tau) for where, node in bare for tau in PUT_IN_S]
        return tuple(found)

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where = sites.places[self.node]
        capacity, conductance = (sites.values[f"{self.name}.{k}"] for k in ("capacity", "conductance"))
        if not capacity or not conductance:
            return ()
        takes = "has a mass beside it that is {value} more than when commissioned"
        passes = "exchanges {value} more with the mass beside it than when commissioned"
        masses = (
            self.parameter_candidate(
                "capacity",
                "thermal_mass",
                where,
                "history",
                EffectSize("J/K", 0.1 * capacity, -0.9 * capacity, 10.0 * capacity),
                takes,
            ),
            self.parameter_candidate(
                "conductance",
                "thermal_mass",
                where,
                "history",
                EffectSize("W/K", 0.1 * conductance, -0.9 * conductance, 10.0 * conductance),
                passes,
            ),
        )
        return tuple(replace(mass, shapes=("step",)) for mass in masses)

    def emit(self, n: Names) -> Fragment:
        if n.constant("capacity") == 0.0 or n.constant("conductance") == 0.0:
            return Fragment()
        speed, mass, node = n.local("speed"), n.state("mass"), n.temperature(self.node)
        capacity, conductance = n.par("capacity"), n.par("conductance")
        strength = n.local("g")
        return Fragment(
            sample=(
                (speed, f"{conductance} / ({capacity} + {LEAST_S!r} * {conductance} + 1e-9)"),
                (strength, f"{speed} * {capacity}"),
            ),
            heat={self.node: f"{strength} * ({mass} - {node})"},
            conductance={self.node: strength},
            states=(ElementState("mass", rate=f"{speed} * ({node} - {mass})", start=node, speed=speed),),
        )


def _most(capacitance: float) -> float:
    """Return the largest exchange of a mass, W/K, with a node of this capacitance.

    An exchange beyond the node's own transfer in its warm-up time is stiff and not identifiable.
    """
    return min(max(MOST, capacitance / SLOWEST_S), capacitance / QUICKEST_S) if capacitance else MOST


def _mass(where: str, node: str, room: str, most: float, tau: float) -> Candidate:
    """Return a mass with a time constant, at its onset as warm as its place, or as the `room` where that is named."""
    name = f"mass_beside_{node}"
    says = "has had a mass put in at the temperature of the room, which" if room else "has a mass beside it that"
    says += " follows through {value} with a time constant {slow}"
    return Candidate(
        "thermal_mass",
        where,
        "history",
        "new",
        {f"{name}.conductance": 1.0, f"{name}.capacity": tau},
        "W/K",
        2.0,
        LEAST_PUT_IN if room else 0.0,
        min(most, MOST_CAPACITY / tau),
        says,
        adds={name: {"kind": HiddenMass.kind, "node": node}},
        shapes=("put in",) if room else ("step",),
        begins=room,
        slow_s=tau,
        slower=partial(_mass, where, node, room, most),
    )
