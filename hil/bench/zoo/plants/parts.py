"""Parts of a plant, and their assembly into a network of cells.

A loop is a list of stations, a station one part or several in parallel. Each part has a bypass, closed unless the part
says otherwise. After each station comes a pipe, whose last cell is the tee where streams meet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hil.bench.zoo.plants.cells import ROOM, CellNetwork

WATER_J_PER_L_K = 4150.0
"""Heat capacity of a litre of coolant."""
MIXING = 0.1
"""Axial exchange of neighbouring cells as a share of the loop's capacity flow, beside that of the upwind scheme."""


@dataclass(frozen=True)
class PlantPart:
    """A part of a plant: `litres` of water in `cells` cells, each with a wall of its own if `metal` (J/K) is above 0.

    `film` is W/K between water and wall, `loss` W/K to the room at a difference of 20 K, `fan` W/K by a fan at full
    speed. `heat` is the column that heats the wall (the water, without one). `reads` says where the thermometer sits:
    "metal", "water" or "". `layered` water mixes by buoyancy alone. `leak` is the share of the water that takes the
    bypass in the healthy plant. `node` is the volume of a lumped twin that the part belongs to.
    """

    name: str
    node: str
    litres: float
    cells: int
    metal: float = 0.0
    film: float = 0.0
    loss: float = 0.0
    fan: float = 0.0
    heat: str = ""
    reads: str = ""
    layered: bool = False
    leak: float = 0.0


@dataclass(frozen=True)
class Loop:
    """A loop: `stations` of parts, each with the `litres` of the pipe after it, and shares of parallel parts."""

    pump: str
    kg_s: float
    stations: tuple[tuple[PlantPart, ...], ...]
    pipe_litres: tuple[float, ...]
    pipe_metal: float = 0.0
    pipe_loss: float = 0.0
    shares: tuple[float, ...] = ()
    cp: float = WATER_J_PER_L_K
    curvature: float = 3.0e-4
    density: float = 3.0e-4
    viscosity: float = 0.0
    pump_exponent: float = 1.0


@dataclass(frozen=True)
class BuiltPart:
    """Cells and groups of one part: indices of water and wall, bypass, and groups of links by name."""

    part: PlantPart
    loop: int
    water: tuple[int, ...]
    metal: tuple[int, ...]
    gate: int
    film_group: int
    loss_group: int
    fan_group: int


class Link(NamedTuple):
    """Conductance between the cells `a` and `b`, W/K, in the order of the kernel's columns.

    `loop`, `flow` and `fan` are the loop whose flow counts, its exponent and that of the fan; `warmth` is the growth
    with mean temperature in 1/K. `natural` is 1 for natural convection, `layer` 1 for a link from an upper layer to
    the one below it.
    """

    a: int
    b: int
    conductance: float
    group: int
    loop: int = -1
    flow: float = 0.0
    fan: float = 0.0
    warmth: float = 0.0
    natural: int = 0
    layer: int = 0


@dataclass
class Assembly:
    """Growing lists of a network's cells, streams and links."""

    capacity: list[float] = field(default_factory=list)
    curvature: list[float] = field(default_factory=list)
    streams: list[tuple[int, int, int, float, int, int]] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    heats: list[tuple[int, str, float]] = field(default_factory=list)
    gates: list[float] = field(default_factory=list)
    groups: int = 0

    def cell(self, capacity: float, curvature: float = 0.0) -> int:
        """Add a cell; return its index."""
        self.capacity.append(capacity)
        self.curvature.append(curvature)
        return len(self.capacity) - 1

    def group(self) -> int:
        """Return the index of a new group of links."""
        self.groups += 1
        return self.groups - 1


def assemble(
    loops: Sequence[Loop], columns: Sequence[str], exchanger: tuple[str, str, float] | None, ballast: tuple[str, float]
) -> tuple[CellNetwork, tuple[BuiltPart, ...], int, int]:
    """Build the network of cells.

    Parameters
    ----------
    loops, columns
        The loops, and the heat columns in the order of `Drive.heat`.
    exchanger
        Names of the part on the hot side and on the cold one, in counterflow, and W/K between wall and cold water.
    ballast
        Part and J/K of a body beside it that exchanges nothing in a healthy plant.

    Returns
    -------
    tuple
        Network, parts, cell of the ballast, group of its link (1 W/K times its factor minus 1).
    """
    a = Assembly()
    built: list[BuiltPart] = []
    pump_cells: list[int] = []
    mixing = a.group()
    for q, loop in enumerate(loops):
        _loop(a, q, loop, built, pump_cells, mixing)
    by_name = {b.part.name: b for b in built}
    if exchanger is not None:
        hot, cold, conductance = by_name[exchanger[0]], by_name[exchanger[1]], exchanger[2]
        for k, wall in enumerate(hot.metal):
            water = cold.water[-1 - k * len(cold.water) // len(hot.metal)]
            each = conductance / len(hot.metal)
            a.links.append(Link(wall, water, each, cold.film_group, loop=cold.loop, flow=0.7, warmth=0.004))
    beside = by_name[ballast[0]]
    body, body_group = a.cell(ballast[1]), a.group()
    a.links.append(Link(body, beside.water[-1], NOTHING, body_group))
    return _network(a, loops, columns, pump_cells), tuple(built), body, body_group


NOTHING = 1.0e-6
"""Conductance of the ballast in a healthy plant, W/K."""


def _loop(a: Assembly, q: int, loop: Loop, built: list[BuiltPart], pump_cells: list[int], mixing: int) -> None:
    tees: list[list[int]] = []
    for litres in loop.pipe_litres:
        count = max(1, min(8, round(litres / max(loop.kg_s, 1e-6) / 4.0)))
        cells = [a.cell(litres / count * loop.cp, loop.curvature) for _ in range(count)]
        loss = a.group()
        for k, water in enumerate(cells):
            outside = water
            if loop.pipe_metal > 0.0:
                outside = a.cell(loop.pipe_metal * litres / count)
                a.links.append(Link(water, outside, 30.0 * loop.kg_s * 60.0 / count, loss, loop=q, flow=0.8))
            a.links.append(Link(outside, ROOM, loop.pipe_loss * litres / count, loss, natural=1))
            if k:
                a.streams.append((q, cells[k - 1], water, 1.0, -1, 0))
        tees.append(cells)
    pump_cells.append(tees[-1][-1])
    for s, station in enumerate(loop.stations):
        before, after = tees[s - 1][-1], tees[s][0]
        shares = loop.shares if len(station) > 1 else (1.0,)
        for part, share in zip(station, shares, strict=True):
            made = _part(a, q, loop, part, share, mixing)
            built.append(made)
            path = [before, *made.water, after]
            for one, other in zip(path[:-1], path[1:], strict=True):
                a.streams.append((q, one, other, share, made.gate, 0))
            a.streams.append((q, before, after, share, made.gate, 1))


def _part(a: Assembly, q: int, loop: Loop, part: PlantPart, share: float, mixing: int) -> BuiltPart:
    n = part.cells
    water = tuple(a.cell(part.litres / n * loop.cp, loop.curvature) for _ in range(n))
    film, loss, fan = a.group(), a.group(), a.group()
    for k in range(1, n):
        strength = MIXING * loop.kg_s * share * loop.cp
        if part.layered:
            a.links.append(Link(water[k - 1], water[k], 0.02 * strength, mixing, layer=1))
        else:
            a.links.append(Link(water[k - 1], water[k], strength, mixing, loop=q, flow=1.0))
    metal: tuple[int, ...] = ()
    if part.metal > 0.0:
        metal = tuple(a.cell(part.metal / n) for _ in range(n))
        for one, wall in zip(water, metal, strict=True):
            a.links.append(Link(one, wall, part.film / n, film, loop=q, flow=0.7, warmth=0.004))
    outer = metal or water
    for cell in outer:
        if part.loss > 0.0:
            a.links.append(Link(cell, ROOM, part.loss / n, loss, natural=1))
        if part.fan > 0.0:
            a.links.append(Link(cell, ROOM, part.fan / n, fan, fan=0.62))
        if part.heat:
            a.heats.append((cell, part.heat, 1.0 / n))
    a.gates.append(part.leak)
    return BuiltPart(part, q, water, metal, len(a.gates) - 1, film, loss, fan)


def _network(a: Assembly, loops: Sequence[Loop], columns: Sequence[str], pump_cells: list[int]) -> CellNetwork:
    def whole(values: Sequence[object]) -> np.ndarray:
        return np.array(values, dtype=np.int64)

    def real(values: Sequence[object]) -> np.ndarray:
        return np.array(values, dtype=np.float64)

    s, k = list(zip(*a.streams, strict=True)), list(zip(*a.links, strict=True))
    return CellNetwork(
        capacity=real(a.capacity),
        curvature=real(a.curvature),
        stream_loop=whole(s[0]),
        stream_from=whole(s[1]),
        stream_to=whole(s[2]),
        stream_share=real(s[3]),
        stream_gate=whole(s[4]),
        stream_skips=whole(s[5]),
        link_a=whole(k[0]),
        link_b=whole(k[1]),
        link_G=real(k[2]),
        link_group=whole(k[3]),
        link_flow=whole(k[4]),
        link_flow_exponent=real(k[5]),
        link_fan_exponent=real(k[6]),
        link_warmth=real(k[7]),
        link_natural=whole(k[8]),
        link_layer=whole(k[9]),
        loop_kg_s=real([loop.kg_s for loop in loops]),
        loop_cp=real([loop.cp for loop in loops]),
        loop_pump_cell=whole(pump_cells),
        loop_pump_exponent=real([loop.pump_exponent for loop in loops]),
        loop_density=real([loop.density for loop in loops]),
        loop_viscosity=real([loop.viscosity for loop in loops]),
        gate=real(a.gates),
        heat_cell=whole([h[0] for h in a.heats]),
        heat_column=whole([columns.index(h[1]) for h in a.heats]),
        heat_share=real([h[2] for h in a.heats]),
        groups=a.groups,
    )
