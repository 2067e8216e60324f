"""Checks of a network's structure: closed, within reach of heat, and read by at least one sensor."""

from __future__ import annotations

from collections.abc import Callable

from twin.elements import Element
from twin.elements.actuator import Actuator
from twin.elements.bypass import Bypass
from twin.elements.empirical_heat import EmpiricalHeat
from twin.elements.exchanger import Exchanger
from twin.elements.flow import Flow
from twin.elements.heat_source import HeatSource
from twin.elements.law import LawOfInput
from twin.elements.law_flow import LawFlow
from twin.elements.law_fluid import LawFluid
from twin.elements.law_heat import LawHeat
from twin.elements.law_reading import LawReading
from twin.elements.limiter import Limiter
from twin.elements.meter import Meter
from twin.elements.node import Node
from twin.elements.pipe import Pipe
from twin.elements.radiator import Radiator
from twin.elements.sensor import Sensor
from twin.network.model import did_you_mean


def check_topology(elements: tuple[Element, ...], most_nodes: int, fail: Callable[[str, str], object]) -> None:
    """Check that the elements are connected; call `fail(element name, sentence)` for the first problem."""
    nodes = [e.name for e in elements if isinstance(e, Node)]
    if not nodes:
        fail("", "there is no node; add an element of kind 'node'")
    if len(nodes) > most_nodes:
        fail(nodes[most_nodes], f"there are {len(nodes)} nodes; the kernel takes at most {most_nodes}")
    for element in elements:
        for node in element.nodes():
            if node not in nodes:
                fail(element.name, f"no such node {node!r}{did_you_mean(node, nodes)}")
    flows = [e for e in elements if isinstance(e, Flow)]
    fed: dict[str, str] = {}
    for flow in flows:
        for node in flow.path:
            if node in fed:
                fail(flow.name, f"node {node!r} is already fed by {fed[node]!r}; two flows need a mixer")
            fed[node] = flow.name
    _pipes_and_drives(elements, fed, fail)
    _named_elements(elements, fail)
    _on_a_flow_path(elements, flows, fail)
    _all_reachable(elements, nodes, fail)
    sensors = [e for e in elements if isinstance(e, Sensor)]
    if not sensors:
        fail("", "there is no sensor; add an element of kind 'sensor'")
    read: dict[str, str] = {}
    for sensor in (e for e in elements if isinstance(e, Sensor | Meter)):
        for column in sensor.measured:
            if column in read:
                fail(sensor.name, f"column {column!r} is already read by sensor {read[column]!r}")
            read[column] = sensor.name


def _pipes_and_drives(elements: tuple[Element, ...], fed: dict[str, str], fail: Callable[[str, str], object]) -> None:
    piped: dict[str, str] = {}
    driven: dict[str, str] = {}
    for e in elements:
        if isinstance(e, Pipe):
            if e.to not in fed:
                fail(e.name, f"no flow path names {e.to!r}, so no water comes through this pipe")
            if e.to in piped:
                fail(e.name, f"node {e.to!r} already has the pipe {piped[e.to]!r}; join them into one")
            piped[e.to] = e.name
        if isinstance(e, Actuator):
            if e.column in driven:
                fail(e.name, f"input {e.column!r} already has the actuator {driven[e.column]!r}; join them into one")
            driven[e.column] = e.name


def _named_elements(elements: tuple[Element, ...], fail: Callable[[str, str], object]) -> None:
    """Check that elements which change another element, or an input, name one that takes the change."""
    kinds = {e.name: e.kind for e in elements}
    driven = {e.column for e in elements if isinstance(e, Actuator)}
    for e in elements:
        for key, field in e.places().items():
            if field.metadata["role"] != "element":
                continue
            other, wanted = getattr(e, field.name), field.metadata["kinds"]
            known = [name for name, kind in kinds.items() if kind in wanted]
            if other not in known:
                hint = did_you_mean(other, known) or f"; it has: {', '.join(known) or 'none'}"
                fail(e.name, f"{key} {other!r} is no element of kind {' or '.join(wanted)}{hint}")
        if isinstance(e, LawOfInput | Limiter) and e.column not in driven:
            fail(e.name, f"input {e.column!r} has no actuator to change; add an element of kind 'actuator' for it")


def _on_a_flow_path(elements: tuple[Element, ...], flows: list[Flow], fail: Callable[[str, str], object]) -> None:
    """Check that elements which correct the water of a flow path stand on one."""
    for e in elements:
        if isinstance(e, Bypass):
            row = list(zip(e.around, e.around[1:], strict=False))
            if not any(
                set(e.around) <= set(flow.path) and all(flow.feeds()[after] == before for before, after in row)
                for flow in flows
            ):
                fail(e.name, f"{', '.join(e.around)} do not follow one another on one flow path")
        if isinstance(e, Radiator) and e.form != "outlet":
            if not any(e.node in flow.path for flow in flows):
                fail(e.name, f"the form {e.form!r} needs water, but no flow path names {e.node!r}")
            if any(e.node in flow.film for flow in flows):
                fail(e.name, f"the form {e.form!r} has a film of its own; take {e.node!r} out of the film of its flow")
        if isinstance(e, Exchanger):
            for node in (e.a, e.b):
                if not any(node in flow.path for flow in flows):
                    fail(
                        e.name,
                        f"an exchanger needs water on both sides, but no flow path names {node!r}; use a conduction",
                    )
                if any(node in flow.film for flow in flows):
                    fail(e.name, f"an exchanger has films of its own; take {node!r} out of the film of its flow")


def _all_reachable(elements: tuple[Element, ...], nodes: list[str], fail: Callable[[str, str], object]) -> None:
    """Check that all nodes are connected, or that each component has heat of its own or a way to the room."""
    acting = [e for e in elements if not isinstance(e, Node | Sensor | LawReading | LawFlow)]
    neighbours: dict[str, set[str]] = {node: set() for node in nodes}
    for element in acting:
        touched = element.nodes()
        for node in touched:
            neighbours[node].update(touched)
    parts: list[set[str]] = []
    for node in nodes:
        if any(node in part for part in parts):
            continue
        part, frontier = {node}, [node]
        while frontier:
            for near in neighbours[frontier.pop()] - part:
                part.add(near)
                frontier.append(near)
        parts.append(part)
    if len(parts) == 1:
        return
    for part in parts:
        if not any(_brings_heat(e) and part & set(e.nodes()) for e in acting):
            node = next(n for n in nodes if n in part)
            fail(
                node,
                "no heat can reach this node; give it a heat source or a loss to the room, put it on a flow path or "
                "add a conduction",
            )


def _brings_heat(element: Element) -> bool:
    """Return True for an element that exchanges heat with the outside: a source, or one with a temperature as input."""
    return isinstance(element, HeatSource | EmpiricalHeat | LawHeat | LawFluid) or any(
        c.endswith("_C") for c in element.inputs()
    )
