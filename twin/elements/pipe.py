"""Pipe before a node: plug flow, a wall with heat capacity, a loss to the room.

    w_d(t)  = w(t - t'),  t' such that the flow from t - t' to t is the volume           plug flow
    w_e     = w_d - e (w_d - T_w),     e = 1 - exp(-wall_hA / m cp)                      wall
    C_w dT_w/dt = m cp e (w_d - T_w)
    w_out   = T_amb + (w_e - T_amb) exp(-loss_hA / m cp)                                 loss

with w the water leaving the node before it on the flow path. The wall stands at the outlet, as one capacity
that exchanges with the passing water. Heat is conserved and the mean delay is (volume + C_w / density cp) / q, as in a
pipe whose wall is heated along its length. Every term vanishes at 0: no volume, no wall, no loss.

Sources: van der Heijde et al., Dynamic equation-based thermo-hydraulic pipe model for district heating and cooling
systems, Energy Conversion and Management 151 (2017) 158-169 (plug flow, wall capacity lumped at the outlet, loss by
residence); Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., sec. 8.3 (exponentials in UA / m cp).

A wall that follows the water faster than LEAST_S counts as slower: e is reduced by C_w / (C_w + m cp e LEAST_S). This
ends at no exchange with no capacity and keeps the time constants of the network finite. With no capacity it is still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.flow import WATER_DENSITY
from twin.elements.fragments import ElementState, Fragment, PlugFlowDelay

LEAST_S = 1.0
"""Shortest time constant of a wall, and of a volume whose water passes as a plug, s."""
LUMPED_S, PIPED_S = 20.0, 6.0
"""Transport time that a twin of mixed volumes may hide, s, and one with pipes, which does not model mixing in them."""
WALL_CONSTANTS_S = (3.0, 10.0, 30.0, 100.0, 300.0)
"""Capacity over film of candidate walls, s."""
NONE = 1.0e-9
"""Capacity of an absent wall, J/K: its state stands still, instead of making every step as short as LEAST_S."""
_STILL = "1e-9"


@dataclass(frozen=True)
class Pipe(Element):
    """Delay, wall and loss of the water on its way to a node."""

    kind: ClassVar[str] = "pipe"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("volume", "L", None, 0.0, 1.0e4, "fixed", "inner cross section times length"),
        ParameterSpec("wall_capacity", "J/K", 0.0, 0.0, 1.0e7, "fixed", "mass of the wall times its specific heat"),
        ParameterSpec("wall_hA", "W/K", 1000.0, 0.0, 1.0e6, "fixed", "water to wall, Incropera 8.5"),
        ParameterSpec("loss_hA", "W/K", 0.0, 0.0, 1000.0, "fixed", "through the insulation to the room"),
    )

    to: str = place("node", "node that the pipe leads to; it must be on a flow path")
    ambient: str = place("input", "input column with the room temperature in degC", unit="degC", default="T_ambient_C")

    def problem(self, values: Mapping[str, float]) -> str | None:
        return None

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        piped = {e.to for e in sites.having(cls.kind)}
        plugs = tuple(_plug(sites, node) for node, before in sites.before.items() if not before and node not in piped)
        return plugs + tuple(
            Candidate(
                "delay",
                sites.places[node],
                "history",
                "new",
                {f"{name}.volume": 1.0},
                "L",
                0.5,
                0.0,
                50.0,
                "gets its water later, as through a further {value} of pipe",
                adds={name: {"kind": cls.kind, "to": node, "ambient": sites.room}},
                shapes=("step",),
                lumped=(PIPED_S if piped else LUMPED_S) * sites.litres_per_s,
            )
            for node in sites.before
            if node not in piped and sites.room and (name := f"pipe_to_{node}")
        )

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        says = "gets its water later, as through a further {value} of pipe"
        # A delay, bounded at zero: a fit that asks for less of the pipe refuses it.
        volume = self.parameter_candidate(
            "volume", "delay", sites.places[self.to], "history", EffectSize("L", 0.2, 0.0, 50.0), says
        )
        return (replace(volume, shapes=("step",), lumped=PIPED_S * sites.litres_per_s), *self._walls(sites))

    def _walls(self, sites: Sites) -> tuple[Candidate, ...]:
        """Return candidates for the wall of a pipe from outside; in a loop the volumes' capacities hold the metal."""
        if sites.before.get(self.to) != "" or sites.values[f"{self.name}.wall_capacity"]:
            return ()
        capacity, rate = f"{self.name}.wall_capacity", f"{self.name}.wall_hA"
        return tuple(
            Candidate(
                "thermal_mass",
                sites.places[self.to],
                "history",
                "new",
                {capacity: 1.0, rate: 1.0 / tau},
                "J/K",
                1000.0,
                0.0,
                1.0e7,
                "passes a wall that takes up heat, {value}",
                shapes=("step",),
            )
            for tau in WALL_CONSTANTS_S
        )

    def emit(self, n: Names) -> Fragment:
        stream = n.streams[self.to]
        water, flow = n.local(f"to_{self.to}", stream.flow), n.local("q", stream.flow)
        mcp = n.local("mcp", stream.flow)
        through, sample, stage = ["1.0"], [], []
        states: tuple[ElementState, ...] = ()
        delay = None
        start = n.temperature(stream.before or self.to)
        passing = water
        if n.constant("volume") != 0.0:
            delay = PlugFlowDelay(water=water, flow=flow, volume=n.par("volume"), start=start)
            late, passing = n.local("late"), n.local("passing")
            stage.append((passing, f"(1.0 - {late}) * {water} + {late} * {n.outlet()}"))
            through.append(f"(1.0 - {late})")
        rest = f"{n.local('late')} * {n.outlet()}" if delay else "0.0"
        if n.constant("wall_capacity") != 0.0:
            share, speed, wall = n.local("share"), n.local("speed"), n.state("wall")
            full, capacity = n.local("full"), n.par("wall_capacity")
            bottom = f"({capacity} + {LEAST_S!r} * {mcp} * {full} + {_STILL})"
            sample += [
                (full, f"1.0 - exp(-{n.par('wall_hA')} / max({mcp}, {_STILL}))"),
                (speed, f"{mcp} * {full} / {bottom} * ({capacity} / ({capacity} + {NONE}))"),
                (share, f"{full} * {capacity} / {bottom}"),
            ]
            states = (ElementState("wall", rate=f"{speed} * ({passing} - {wall})", start=start, speed=speed),)
            through.append(f"(1.0 - {share})")
            rest = f"((1.0 - {share}) * ({rest}) + {share} * {wall})"
        if n.constant("loss_hA") != 0.0:
            kept = n.local("kept")
            sample.append((kept, f"exp(-{n.par('loss_hA')} / max({mcp}, {_STILL}))"))
            through.append(kept)
            rest = f"{kept} * ({rest}) + (1.0 - {kept}) * {n.input(self.ambient)}"
        sample.append((n.local("through"), " * ".join(through)))
        stage.append((n.local("rest"), rest))
        return Fragment(sample=tuple(sample), stage=tuple(stage), states=states, delay=delay)


def _plug(sites: Sites, node: str) -> Candidate:
    """Return the candidate of incoming water that passes as a plug, where the twin has it mixed in the node's
    volume.

    Some of it stays mixed, as much as flows in `LEAST_S`: an empty volume would make every step as short as nothing.
    """
    name = f"pipe_to_{node}"
    flow = next(e for e in sites.having("flow") if node in e.path)
    per_litre = WATER_DENSITY * sites.values[f"{flow.name}.cp"]
    volume = sites.values[f"{node}.capacitance"] / per_litre
    return Candidate(
        "delay",
        sites.places[node],
        "history",
        "new",
        {f"{name}.volume": 1.0, f"{node}.capacitance": -per_litre},
        "L",
        0.1 * volume,
        0.0,
        max(volume - LEAST_S * sites.litres_per_s, 0.0),
        "holds {value} that pass one after the other, unmixed",
        adds={name: {"kind": Pipe.kind, "to": node, "ambient": sites.room}},
        exhausts=True,
        shapes=("step",),
    )
