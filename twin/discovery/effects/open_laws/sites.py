"""Sites of open laws: the places of a network where something may act with a value of one unit.

A site takes heat into a node or out of one into another, heat into the solid part of a node that its thermometer reads,
a share of a flow, a conductance to the room, or an error of a reading or of the room's thermometer. Its response per
unit is that of the named law there.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.discovery.effects.laws import CandidateLaw, circuit_of
from twin.elements.candidates import free_name
from twin.elements.radiator import Radiator
from twin.network import Array, Network

SOLID_K_PER_W = tuple(float(f"{0.003 * 1.5**i:.3g}") for i in range(7))
"""Temperatures of a solid part above that of its water for each watt that enters it, K/W: those of 330 to 30 W/K
between the two, so close together that the next one is off by a fifth at most."""


@dataclass(frozen=True)
class OpenSite:
    """A place of an open law.

    Attributes:
        name: of its column. kind, where: in a diagnosis's words. tables: elements that act there, following the column.
        changes: parameter -> weight. unit: of a value; `typical`, `lower`, `upper` in it.
        heat, reading: response (n, k) W or (n, m) K per unit; None where it is none. says: with {value}.
        injects, reads: nodes and sensors on which a value of 1 acts, where that is all that it does.
    """

    name: str
    kind: str
    where: str
    tables: Mapping[str, Mapping[str, Any]]
    changes: Mapping[str, float]
    unit: str
    typical: float
    lower: float
    upper: float
    heat: Array | None
    reading: Array | None
    says: str

    injects: Mapping[str, float] = field(default_factory=dict)
    reads: Mapping[str, float] = field(default_factory=dict)

    @property
    def column(self) -> str:
        """Return the name of the column that the site's elements follow."""
        return f"open_{self.name}"


def sites_of(network: Network, named: Sequence[CandidateLaw]) -> list[OpenSite]:
    """Return the sites of a network, with the responses of the named laws there."""
    found: dict[str, OpenSite] = {}
    for law in named:
        c = law.candidate
        if c.shapes == () or c.begins:
            continue
        site: OpenSite | None = None
        if c.kind == "heat_source" and c.driver == "constant" and law.heat is not None:
            site = _heat_site(network, law)
        elif c.kind == "sensor" and c.driver == "constant":
            site = _input_site(network, law) if c.where in network.input_columns else _reading_site(network, law)
        elif circuit_of(network, c):
            site = _flow_site(network, law)
        elif c.kind == "heat_loss" and c.driver == "temperature_difference":
            site = _loss_site(network, law)
        if site is not None:
            found.setdefault(site.name, site)
    for site in [*_transfers(network, named), *_solids(network, list(found.values()))]:
        found.setdefault(site.name, site)
    return list(found.values())


def _plain(text: str) -> str:
    return "".join(ch if ch.isalnum() else "_" for ch in text)


def _heat_site(network: Network, law: CandidateLaw) -> OpenSite:
    """Return the site of heat into the nodes of a place, in the proportions of the named law of constant heat."""
    assert law.heat is not None
    c = law.candidate
    weight = np.abs(law.heat).max(axis=0)
    name = f"heat_{_plain(c.where)}"
    nodes = [(network.nodes[k], float(w / weight.sum())) for k, w in enumerate(weight) if w > 0.0]
    response = law.heat / max(float(law.heat.sum(axis=1).max()), 1e-12)
    elements = {node: free_name(f"{name}_{node}", network.elements) for node, _ in nodes}
    tables = {
        element: {"kind": "law_heat", "node": node, "driver": f"open_{name}", "form": "linear"}
        for node, element in elements.items()
    }
    changes = {f"{elements[node]}.gain": share for node, share in nodes}
    return OpenSite(
        name,
        "heat_source",
        c.where,
        tables,
        changes,
        "W",
        20.0,
        -2000.0,
        2000.0,
        response,
        None,
        "gives off {value}",
        injects=dict(nodes),
    )


def _reading_site(network: Network, law: CandidateLaw) -> OpenSite | None:
    """Return the site of an error of a sensor; None if the named law is of no sensor of the network."""
    c = law.candidate
    names = [key.split(".")[0] for key in c.changes]
    if law.reading is None or any(n not in network.sensor_names for n in names):
        return None
    name = f"read_{_plain(c.where)}"
    elements = {s: free_name(f"{name}_{s}", network.elements) for s in names}
    tables = {
        element: {"kind": "law_reading", "sensor": s, "driver": f"open_{name}", "form": "linear"}
        for s, element in elements.items()
    }
    changes = {f"{element}.gain": 1.0 for element in elements.values()}
    return OpenSite(
        name,
        "sensor",
        c.where,
        tables,
        changes,
        "K",
        0.2,
        -20.0,
        20.0,
        None,
        law.reading,
        "reads {value} too high",
        reads=dict.fromkeys(names, 1.0),
    )


def _input_site(network: Network, law: CandidateLaw) -> OpenSite | None:
    """Return the thermometer of an input, such as the room's: its error acts wherever the input does."""
    c = law.candidate
    if law.heat is None:
        return None
    name = f"read_{_plain(c.where)}"
    added = free_name(name, network.elements)
    table = {"kind": "law_input", "column": c.where, "driver": f"open_{name}", "form": "linear"}
    return OpenSite(
        name,
        "sensor",
        c.where,
        {added: table, **c.adds},
        {f"{added}.gain": 1.0},
        "K",
        c.typical,
        c.lower,
        c.upper,
        law.heat,
        None,
        "reads {value} too high",
    )


def _flow_site(network: Network, law: CandidateLaw) -> OpenSite | None:
    """Return the site of a share of a flow; None without an influence on the record."""
    c = law.candidate
    element = circuit_of(network, c)
    if law.heat is None:
        return None
    factor = network.parameters[f"{element}.factor"].value
    name = f"flow_{_plain(element)}"
    added = free_name(name, network.elements)
    tables = {added: {"kind": "law_flow", "flow": element, "driver": f"open_{name}", "form": "linear"}}
    return OpenSite(
        name,
        "flow",
        c.where,
        tables,
        {f"{added}.gain": 1.0},
        "of the flow",
        0.03,
        -0.8,
        1.0,
        law.heat * factor,
        None,
        "carries {value} more",
    )


def _loss_site(network: Network, law: CandidateLaw) -> OpenSite | None:
    """Return the site of a conductance from one node to the room; None without a room or for several nodes.

    It may lose less by what the twin has there, fins included: a loss below nothing would be heat from a colder room.
    """
    c = law.candidate
    room = network.room
    if law.heat is None or not room:
        return None
    active = np.flatnonzero(np.abs(law.heat).max(axis=0) > 0.0)
    if len(active) != 1:
        return None
    node = network.nodes[int(active[0])]
    name = f"loss_{_plain(node)}"
    element = free_name(name, network.elements)
    fins = [e.name for e in network.elements if isinstance(e, Radiator) and e.node == node]
    has = sum(network.parameters[f"{each}.UA_100"].value for each in fins) - min(c.lower, 0.0)
    tables = {
        element: {"kind": "law_conductance", "node": node, "ambient": room, "driver": f"open_{name}", "form": "linear"}
    }
    return OpenSite(
        name,
        "heat_loss",
        c.where,
        tables,
        {f"{element}.gain": 1.0},
        "W/K",
        1.0,
        -min(has, 60.0),
        60.0,
        law.heat,
        None,
        "loses {value} more to the room",
    )


def _solids(network: Network, sites: Sequence[OpenSite]) -> Iterator[OpenSite]:
    """Yield heat into the solid part of a volume that its thermometer reads: the water shows all of the heat, and the
    thermometer what the solid is warmer by besides."""
    for site in sites:
        if site.kind != "heat_source" or site.heat is None or len(site.injects) != 1:
            continue
        (node,) = site.injects
        sensors = [s.name for s in network.sensors if s.node == node]
        if not sensors:
            continue
        reading = np.zeros((len(site.heat), len(network.sensors)))
        reading[:, [network.sensor_names.index(s) for s in sensors]] = 1.0
        for above in SOLID_K_PER_W:
            name = f"solid_{_plain(site.where)}_{round(1e5 * above)}"
            heat = free_name(f"{name}_heat", network.elements)
            of_sensor = {s: free_name(f"{name}_{s}", network.elements) for s in sensors}
            column = f"open_{name}"
            tables: dict[str, dict[str, Any]] = {
                heat: {"kind": "law_heat", "node": node, "driver": column, "form": "linear"}
            }
            tables |= {
                element: {"kind": "law_reading", "sensor": s, "driver": column, "form": "linear"}
                for s, element in of_sensor.items()
            }
            changes = {f"{heat}.gain": 1.0} | {f"{element}.gain": above for element in of_sensor.values()}
            yield OpenSite(
                name,
                "heat_source",
                site.where,
                tables,
                changes,
                "W",
                site.typical,
                site.lower,
                site.upper,
                site.heat,
                above * reading,
                "gives off {value} into its solid part",
                injects={node: 1.0},
                reads=dict.fromkeys(sensors, above),
            )


def _transfers(network: Network, named: Sequence[CandidateLaw]) -> Iterator[OpenSite]:
    """Yield heat that is taken from one node that is read and given to another."""
    count = next((len(law.heat) for law in named if law.heat is not None), 0)
    read = list(dict.fromkeys(s.node for s in network.sensors))
    for a, b in itertools.combinations(read, 2):
        heat = np.zeros((count, len(network.nodes)))
        heat[:, network.nodes.index(a)], heat[:, network.nodes.index(b)] = 1.0, -1.0
        name = f"transfer_{_plain(a)}_{_plain(b)}"
        element = free_name(name, network.elements)
        tables = {element: {"kind": "law_heat", "node": a, "source": b, "driver": f"open_{name}", "form": "linear"}}
        yield OpenSite(
            name,
            "heat_transfer",
            a,
            tables,
            {f"{element}.gain": 1.0},
            "W",
            20.0,
            -2000.0,
            2000.0,
            heat,
            None,
            f"receives {{value}} from {b}",
            injects={a: 1.0, b: -1.0},
        )
