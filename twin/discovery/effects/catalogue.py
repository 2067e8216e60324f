"""Catalogue of effects that a twin may lack: each kind of element at each possible place, and each parameter that may
change.

The kinds themselves declare their possible places and candidates (`Element.missing`, `Element.moved`), so a new kind of
element joins the search by its own file.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from twin.elements import KINDS, Element, Parameter
from twin.elements.candidates import Candidate, Sites, with_free_names
from twin.network import InputSpec, Network, TwinFileError

_NUMBERED = re.compile(r"^(?P<stem>\D+)\d+$")
LATE = ("history", "rate_of_change")
"""Drivers of effects with memory: lags and delays."""
_SPOKEN = {"pm": "modules"}
"""Collective name of a numbered family of nodes; others take their stem and an s."""


def catalogue(network: Network) -> tuple[Candidate, ...]:
    """Return the candidates of a network, each with a unique id."""
    sites = sites_of(network)
    found: dict[str, Candidate] = {}
    for kind in KINDS.values():
        for candidate in kind.missing_candidates(sites):
            renamed = with_free_names(candidate, sites.elements)
            if renamed.lower < renamed.upper:  # a small volume holds no mass that would show
                found.setdefault(renamed.id, renamed)
    for element in network.elements:
        for candidate in element.changed_candidates(sites):
            free = {name for name in candidate.changes if not _bound_to_another(network, name)}
            if len(free) == len(candidate.changes):
                possible = with_free_names(_within_bounds(network, candidate), sites.elements)
                found.setdefault(possible.id, possible)
    return tuple(found.values())


def _within_bounds(network: Network, candidate: Candidate) -> Candidate:
    """Return a parameter change whose possible and typical sizes lie within the parameters' bounds.

    Sizes of interest are those of rigs of some hundred watts. The bounds of a parameter of a smaller rig declare how
    far it may change; beyond them `sized` clips it, and a law of size 1 would be less than 1.
    """
    if candidate.inverse or not candidate.changes:
        return candidate
    low, high = candidate.lower, candidate.upper
    for name, weight in candidate.changes.items():
        p = network.parameters.get(name)
        if p is None or not weight:
            return candidate
        ends = sorted(((p.lower - p.value) / weight, (p.upper - p.value) / weight))
        low, high = max(low, ends[0]), min(high, ends[1])
    widest = max(abs(low), abs(high))
    if not low < high or not widest:
        return candidate
    return replace(candidate, lower=low, upper=high, typical=min(candidate.typical, widest))


def _bound_to_another(network: Network, name: str) -> bool:
    p = network.parameters.get(name)
    return p is not None and bool(p.same_as)


def sites_of(network: Network) -> Sites:
    """Return the sites of a network: its places and its drivers."""
    clock = next((c for c in network.input_columns if c.startswith("time_of_day")), "")
    before = {node: b for e in network.elements for node, b in e.feeds().items()}
    families: dict[str, list[str]] = {}
    for node in network.nodes:
        if match := _NUMBERED.match(node):
            families.setdefault(match["stem"], []).append(node)
    groups = {_SPOKEN.get(stem, stem.rstrip("_") + "s"): tuple(n) for stem, n in families.items() if len(n) > 1}
    return Sites(
        nodes=network.nodes,
        inputs=network.input_columns,
        room=network.room,
        clock=clock,
        before=before,
        places=_places(network),
        groups=groups,
        elements=network.elements,
        values={name: p.value for name, p in network.parameters.items()},
        scales={c: _scale(spec) for c, spec in network.inputs.items()},
        litres_per_s=max((p.value / 60.0 for p in network.parameters.values() if p.unit == "L/min"), default=0.0),
    )


def _scale(spec: InputSpec) -> float:
    """Return the range of an input: the declared one, or a usual one."""
    span = spec.upper - spec.lower
    return span if math.isfinite(span) and span > 0.0 else max(abs(spec.nominal), 1.0)


def _places(network: Network) -> dict[str, str]:
    """Return node -> place: a node without a sensor belongs to the nearest one with a sensor, through solid first."""
    read = {s.node for s in network.sensors}
    beside: dict[str, Counter[str]] = {node: Counter() for node in network.nodes}
    for element in network.elements:
        if element.kind in ("sensor", "flow", "pipe"):
            continue
        touched = element.nodes()
        for a in touched:
            for b in touched:
                if a != b:
                    beside[a][b] += 1
    for element in network.elements:
        for node, before in element.feeds().items():
            if before in beside:
                beside[before][node] += 0  # The water comes last, and goes downstream.
    places = {node: node for node in read}
    for _ in network.nodes:
        for node in network.nodes:
            known = [b for b in beside[node] if b in places]
            if node not in places and known:
                places[node] = places[known[0]]
    return {node: places.get(node, node) for node in network.nodes}


def with_columns(network: Network, columns: Sequence[str]) -> Network:
    """Return the network with further input columns, for the values of open laws; a missing one has the nominal value
    0.
    """
    if not columns:
        return network
    inputs = dict(network.inputs)
    for column in columns:
        inputs.setdefault(column, InputSpec(column, 0.0, -1.0e9, 1.0e9, "1"))
    return replace(network, inputs=MappingProxyType(inputs), digest="")


def extended(network: Network, candidate: Candidate) -> Network:
    """Return the network with a candidate's elements at neutral values, without effect.

    Raises
    ------
    TwinFileError
        The element does not fit this network.
    """
    network = with_columns(network, [candidate.column] if candidate.column else [])
    elements = list(network.elements)
    parameters = dict(network.parameters)
    for name, table in candidate.adds.items():
        if name in {e.name for e in elements}:
            raise TwinFileError(f"twin {network.name!r} already has an element {name!r}")
        _insert(elements, parameters, name, table)
    for name, keys in candidate.replaces.items():
        old = next(e for e in elements if e.name == name)
        new = replace(old, **{old.places()[k].name: v for k, v in keys.items()})
        elements[elements.index(old)] = new
        _fill(new, parameters)
    elements.sort(key=lambda e: e.kind != "node")
    return replace(network, elements=tuple(elements), parameters=MappingProxyType(parameters), digest="")


def _insert(elements: list[Element], parameters: dict[str, Parameter], name: str, table: Mapping[str, Any]) -> None:
    cls = KINDS[str(table["kind"])]
    places = cls.places()
    given = {places[k].name: tuple(v) if isinstance(v, list) else v for k, v in table.items() if k in places}
    element = cls(name=name, **given)
    elements.append(element)
    _fill(element, parameters, table)


def _fill(element: Element, parameters: dict[str, Parameter], given: Mapping[str, Any] = MappingProxyType({})) -> None:
    for spec in element.parameter_specs():
        key = f"{element.name}.{spec.name}"
        if key not in parameters:
            value = spec.default if spec.default is not None else _neutral(spec.lower, spec.upper)
            value = float(given.get(spec.name, value))
            parameters[key] = Parameter(
                key, element.name, spec.name, value, spec.unit, spec.lower, spec.upper, spec.status, spec.source
            )


def _neutral(lower: float, upper: float) -> float:
    return 0.0 if lower <= 0.0 <= upper else upper


def sized(network: Network, candidate: Candidate, size: float) -> dict[str, float]:
    """Return the parameter values of an extended network at a size of the candidate, within the parameters' bounds."""
    values = {}
    for name, weight in candidate.changes.items():
        p = network.parameters[name]
        if candidate.inverse:
            value = weight / size if size > weight / p.upper else p.upper
        else:
            value = p.value + weight * size
        values[name] = min(max(value, p.lower), p.upper)
    return values
