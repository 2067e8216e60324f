"""Families of random plants, half of them for development and half sealed.

A plant follows from its family and a seed. Powers, volumes and flows of the plants of one family spread over a decade;
each value then spreads by itself. The data sheet holds nominal values that are off by some ten per cent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hil.bench.zoo.plants.parts import Loop, PlantPart, assemble
from hil.bench.zoo.plants.plant import Thermometer, ZooPlant

Draw = Callable[[np.random.Generator, float], tuple[list[Loop], tuple[str, str, float] | None]]

REFERENCE_W = 800.0
"""Power of a plant of size 1; its flow is 4 L/min and its tank holds 15 L."""
SHEET_ERROR = 0.10
"""Standard deviation of the logarithm of a nominal value over the true one."""


def _spread(rng: np.random.Generator, value: float, factor: float = 1.4) -> float:
    return float(value * np.exp(rng.uniform(-np.log(factor), np.log(factor))))


def _heater(rng: np.random.Generator, s: float, **more: Any) -> PlantPart:
    base = PlantPart(
        "heater",
        "heater",
        _spread(rng, 0.6 * s),
        4,
        _spread(rng, 900.0 * s),
        _spread(rng, 120.0 * s),
        _spread(rng, 1.2 * s**0.7),
        heat="heater_power_W",
        reads="water",
    )
    return replace(base, **more)


def _radiator(rng: np.random.Generator, s: float, **more: Any) -> PlantPart:
    base = PlantPart(
        "radiator",
        "radiator",
        _spread(rng, 0.5 * s),
        5,
        _spread(rng, 400.0 * s),
        _spread(rng, 300.0 * s),
        _spread(rng, 1.0 * s**0.7),
        fan=_spread(rng, 50.0 * s),
        reads="water",
    )
    return replace(base, **more)


def _tank(rng: np.random.Generator, s: float, **more: Any) -> PlantPart:
    base = PlantPart("tank", "tank", _spread(rng, 15.0 * s, 2.0), 3, loss=_spread(rng, 2.5 * s**0.7), reads="water")
    return replace(base, **more)


def _cell(rng: np.random.Generator, s: float, k: int, **more: Any) -> PlantPart:
    base = PlantPart(
        f"cell{k}",
        f"cell{k}",
        _spread(rng, 0.12 * s),
        2,
        _spread(rng, 500.0 * s),
        _spread(rng, 45.0 * s),
        _spread(rng, 0.4 * s**0.7),
        reads="metal",
    )
    return replace(base, **more)


def _loop(
    rng: np.random.Generator,
    s: float,
    stations: Sequence[tuple[PlantPart, ...]],
    pump: str = "pump_speed_pct",
    **more: Any,
) -> Loop:
    base = Loop(
        pump,
        _spread(rng, 4.0 * s) / 60.0,
        tuple(stations),
        tuple(_spread(rng, 0.15 * s) for _ in stations),
        pipe_loss=_spread(rng, 0.3),
        shares=(lambda a: (a, 1.0 - a))(float(rng.uniform(0.35, 0.65))),
        cp=_spread(rng, 4000.0, 1.05),
        curvature=float(rng.uniform(1e-4, 1e-3)),
        density=float(rng.uniform(2e-4, 6e-4)),
        viscosity=float(rng.uniform(0.0, 1.5e-3)),
        pump_exponent=float(rng.uniform(1.0, 1.08)),
    )
    return replace(base, **more)


def _serial(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    cell = _cell(
        rng, s, 1, name="load", node="load", metal=_spread(rng, 2000.0 * s), cells=4, film=_spread(rng, 150.0 * s)
    )
    return [_loop(rng, s, [(_heater(rng, s),), (cell,), (_radiator(rng, s),), (_tank(rng, s),)])], None


def _cells(rng: np.random.Generator, s: float, count: int, reads: str, heated: bool) -> tuple[list[Loop], None]:
    cells = [_cell(rng, s, k + 1, reads=reads, heat="cells_power_W" if heated else "") for k in range(count)]
    stations = [(_heater(rng, s),), *((c,) for c in cells), (_radiator(rng, s),), (_tank(rng, s),)]
    return [_loop(rng, s, stations)], None


def _cells_on_metal(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    return _cells(rng, s, int(rng.integers(2, 5)), "metal", False)


def _cells_in_water(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    return _cells(rng, s, int(rng.integers(3, 7)), "water", True)


def _lumped_cells(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    """Ten heat sinks that the twin holds as one volume, and a layered tank."""
    loops, _ = _cells(rng, 0.5 * s, 10, "metal", False)
    stations = [
        tuple(replace(p, node="cells" if p.name.startswith("cell") else p.node) for p in st) for st in loops[0].stations
    ]
    stations[-1] = (replace(stations[-1][0], layered=True, cells=5),)
    return [replace(loops[0], stations=tuple(stations))], None


def _exchanger(rng: np.random.Generator, s: float) -> tuple[list[Loop], tuple[str, str, float]]:
    hot = PlantPart(
        "hot", "hot", _spread(rng, 0.5 * s), 5, _spread(rng, 500.0 * s), _spread(rng, 200.0 * s), reads="water"
    )
    cold = PlantPart("cold", "cold", _spread(rng, 0.5 * s), 5, reads="water")
    first = _loop(rng, s, [(_heater(rng, s),), (hot,), (_tank(rng, 0.6 * s),)])
    second = _loop(rng, s, [(cold,), (_radiator(rng, s),)], pump="pump2_speed_pct")
    return [first, second], ("hot", "cold", _spread(rng, 200.0 * s))


def _layered(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    tank = _tank(rng, s, layered=True, cells=6)
    return [_loop(rng, s, [(_heater(rng, s),), (_radiator(rng, s),), (tank,)])], None


def _parallel(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    branches = tuple(
        _cell(rng, s, k, metal=_spread(rng, 1200.0 * s), name=f"branch{k}", node="branches") for k in (1, 2)
    )
    return [_loop(rng, s, [(_heater(rng, s),), branches, (_radiator(rng, s),), (_tank(rng, s),)])], None


def _pipes(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    load = _cell(rng, s, 1, name="load", node="load", metal=_spread(rng, 1500.0 * s), film=_spread(rng, 120.0 * s))
    loop = _loop(rng, s, [(_heater(rng, s),), (load,), (_radiator(rng, s),), (_tank(rng, s),)])
    long = tuple(_spread(rng, 1.5 * s, 2.0) for _ in loop.stations)
    return [replace(loop, pipe_litres=long, pipe_metal=_spread(rng, 400.0), pipe_loss=_spread(rng, 0.5))], None


def _leaky_valve(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    radiator = _radiator(rng, s, leak=float(rng.uniform(0.05, 0.25)), fan=_spread(rng, 70.0 * s))
    load = _cell(rng, s, 1, name="load", node="load", metal=_spread(rng, 1500.0 * s), film=_spread(rng, 150.0 * s))
    return [_loop(rng, s, [(_heater(rng, s),), (load,), (radiator,), (_tank(rng, s),)])], None


def _two_tanks(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    store = _tank(rng, s, name="store", node="store", layered=bool(rng.integers(2)))
    buffer = _tank(rng, 0.4 * s, name="buffer", node="buffer")
    return [_loop(rng, s, [(_heater(rng, s),), (store,), (_radiator(rng, s),), (buffer,)])], None


def _branched_exchanger(rng: np.random.Generator, s: float) -> tuple[list[Loop], tuple[str, str, float]]:
    loops, exchanger = _exchanger(rng, s)
    branches = tuple(_cell(rng, s, k, name=f"branch{k}", node="branches", heat="cells_power_W") for k in (1, 2))
    first = loops[0]
    stations = (first.stations[0], branches, *first.stations[1:])
    return [
        replace(first, stations=stations, pipe_litres=(*first.pipe_litres, _spread(rng, 0.15 * s))),
        loops[1],
    ], exchanger


FAMILIES: dict[str, Draw] = {
    "serial": _serial,
    "cells_on_metal": _cells_on_metal,
    "exchanger": _exchanger,
    "layered_tank": _layered,
    "parallel": _parallel,
    "long_pipes": _pipes,
    "cells_in_water": _cells_in_water,
    "lumped_cells": _lumped_cells,
    "leaky_valve": _leaky_valve,
    "two_tanks": _two_tanks,
    "branched_exchanger": _branched_exchanger,
    "glycol_cells": lambda rng, s: _glycol(rng, s),
}
"""Name -> draw of loops and heat exchanger."""
DEVELOPMENT = ("serial", "cells_on_metal", "exchanger", "layered_tank", "parallel", "long_pipes")
SEALED = tuple(name for name in FAMILIES if name not in DEVELOPMENT)
PIPED = ("long_pipes",)
"""Families whose data sheet names the pipes' volumes."""


def _glycol(rng: np.random.Generator, s: float) -> tuple[list[Loop], None]:
    """Cells read in the water or on the metal by chance, in a coolant whose viscosity falls as it warms."""
    cells = [_cell(rng, s, k + 1, reads=str(rng.choice(["water", "metal"]))) for k in range(int(rng.integers(1, 4)))]
    stations = [(_heater(rng, s),), *((c,) for c in cells), (_radiator(rng, s),), (_tank(rng, s),)]
    thick: dict[str, Any] = {"cp": 3500.0, "curvature": 1.2e-3, "viscosity": float(rng.uniform(2e-3, 5e-3))}
    return [_loop(rng, s, stations, **thick)], None


def draw_plant(family: str, seed: int) -> ZooPlant:
    """Return the plant of a family with a seed.

    Raises
    ------
    KeyError
        There is no such family.
    """
    rng = np.random.default_rng([seed, sorted(FAMILIES).index(family)])
    s = float(np.exp(rng.uniform(np.log(0.32), np.log(3.2))))
    loops, exchanger = FAMILIES[family](rng, s)
    parts = [p for loop in loops for station in loop.stations for p in station]
    columns = tuple(dict.fromkeys(p.heat for p in parts if p.heat))
    total = REFERENCE_W * s * float(rng.uniform(0.7, 1.3))
    # A second heat column shares the power with the first.
    full = np.array([total if len(columns) == 1 else total * share for share in (0.5, 0.5)][: len(columns)])
    heated = [p for p in parts if p.node in ("tank", "store", "heater")]
    beside = str(rng.choice([p.name for p in heated]))
    litres = next(p.litres for p in parts if p.name == beside)
    network, built, body, group = assemble(loops, columns, exchanger, (beside, 4000.0 * max(litres, 1.0)))
    # Several heated parts of one column share its power.
    counts = {c: sum(p.heat == c for p in parts) for c in columns}
    share = network.heat_share / np.array([counts[columns[k]] for k in network.heat_column])
    network = replace(network, heat_share=share)
    lag = float(rng.uniform(1.0, 8.0))
    thermometers = tuple(
        Thermometer(
            f"T_{b.part.name}_C",
            b.metal[len(b.metal) // 2] if b.part.reads == "metal" else b.water[-1],
            lag,
            b.part.node,
        )
        for b in built
        if b.part.reads
    )
    sigma = float(np.exp(rng.uniform(np.log(0.01), np.log(0.2))))
    plant = ZooPlant(
        family=family,
        seed=seed,
        network=network,
        parts=built,
        thermometers=thermometers,
        sigma_K=sigma,
        heat_columns=columns,
        full_w=full,
        pumps=tuple(loop.pump for loop in loops),
        sheet={},
        ballast=body,
        ballast_group=group,
    )
    return replace(plant, sheet=_sheet(plant, loops, exchanger, rng))


def _sheet(
    plant: ZooPlant, loops: Sequence[Loop], exchanger: tuple[str, str, float] | None, rng: np.random.Generator
) -> dict[str, Any]:
    """Return the data sheet: what a maker knows of the rig, each number off by some per cent."""

    def nominal(value: float) -> float:
        return float(value * np.exp(SHEET_ERROR * rng.normal()))

    built, columns = plant.parts, plant.heat_columns
    nodes: dict[str, dict[str, Any]] = {}
    for b in built:
        p, loop = b.part, loops[b.loop]
        node = nodes.setdefault(p.node, {"J_per_K": 0.0, "loss_W_per_K": 0.0, "fan_W_per_K": 0.0, "reads": p.reads})
        node["J_per_K"] += nominal(p.litres * loop.cp + p.metal)
        node["loss_W_per_K"] += nominal(max(p.loss, 0.05))
        node["fan_W_per_K"] += nominal(p.fan) if p.fan else 0.0
    paths = []
    for loop in loops:
        path = list(dict.fromkeys(station[0].node for station in loop.stations))
        pipes: dict[str, float] = {}
        for station, litres in zip(loop.stations, loop.pipe_litres, strict=True):
            after = path[(path.index(station[0].node) + 1) % len(path)]
            pipes[after] = pipes.get(after, 0.0) + litres
        if plant.family in PIPED:
            pipes = {name: nominal(litres) for name, litres in pipes.items()}
        else:
            for name, litres in pipes.items():
                nodes[name]["J_per_K"] += nominal(litres * loop.cp)
            pipes = {}
        paths.append(
            {
                "pump": loop.pump,
                "L_per_min": nominal(loop.kg_s * 60.0),
                "path": path,
                "cp": loop.cp,
                "pipes_L": pipes,
            }
        )
    link = None
    if exchanger is not None:
        hot = next(b.part for b in built if b.part.name == exchanger[0])
        link = {"hot": exchanger[0], "cold": exchanger[1], "K_per_W": nominal(1.0 / hot.film + 1.0 / exchanger[2])}
    return {
        "nodes": nodes,
        "loops": paths,
        "exchanger": link,
        "sensors": {n: [t.column for t in plant.thermometers if t.node == n] for n in nodes},
        "sigma_K": plant.sigma_K,
        "heaters": {c: sorted({b.part.node for b in built if b.part.heat == c}) for c in columns},
        "rated_W": dict(zip(columns, (float(x) for x in plant.full_w), strict=True)),
    }
