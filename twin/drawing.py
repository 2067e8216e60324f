"""Picture of a network: volumes along the water, the elements that act on them, inputs and sensors.

Nodes of the flow stand on a ring (one row for an open path) in the order in which the water meets them; other nodes
stand beside the node with which they exchange heat. Sources and sensors stand outside the ring, losses and links inside
or between their ends.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from twin.elements import Element
from twin.elements.actuator import Actuator
from twin.elements.flow import Flow
from twin.elements.law import Law
from twin.elements.law_actuator import LawActuator
from twin.elements.law_flow import LawFlow
from twin.elements.law_reading import LawReading
from twin.elements.meter import Meter
from twin.elements.pipe import Pipe
from twin.elements.sensor import Sensor
from twin.laws import law_equation
from twin.network import Network

Point = tuple[float, float]

WATER, HEAT, READ, DRIVE, SOLID = "#2b6cb0", "#c05621", "#2f855a", "#6b46c1", "#4a5568"
FACE = "#edf2f7"
_WIDE, _HIGH = 1.9, 0.62


def draw(network: Network, path: str | Path) -> Path:
    """Draw a network into a file; its suffix gives the format (svg, png, pdf)."""
    import matplotlib

    with matplotlib.rc_context({"text.parse_math": False}):  # a $ in a title is a $
        return _drawn(network, Path(path))


def _drawn(network: Network, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    places, centre = _places(network)
    xs, ys = [p[0] for p in places.values()], [p[1] for p in places.values()]
    figure = Figure(figsize=(max(xs) - min(xs) + 6.4, max(ys) - min(ys) + 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(min(xs) - 3.0, max(xs) + 3.0)
    axes.set_ylim(min(ys) - 1.9, max(ys) + 1.9)
    axes.set_title(network.title or network.name, fontsize=12, loc="left")
    _water(axes, network, places)
    outside, between = _labels(network, places)
    for ends, text in between.items():
        _link(axes, places[ends[0]], places[ends[1]], text, centre)
    for node, point in places.items():
        _volume(axes, network, node, point)
        _beside(axes, point, _outward(point, centre), outside.get(node, []))
    _legend(axes, network)
    figure.savefig(path, dpi=150)
    return path


def _places(network: Network) -> tuple[dict[str, Point], Point]:
    """Return the position of each node's box, and the middle of the picture."""
    flows = [e for e in network.elements if isinstance(e, Flow)]
    order = list(dict.fromkeys(n for flow in flows for n in flow.path)) or list(network.nodes)
    closed = any(not flow.inlet for flow in flows) and len(order) > 2
    places: dict[str, Point] = {}
    if closed:
        # a rounded rectangle with as many boxes above as below
        top = math.ceil(len(order) / 2)
        step_top, step_low = 3.6, 3.6 * max(top - 1, 1) / max(len(order) - top - 1, 1)
        for k, node in enumerate(order):
            below = len(order) - 1 - k
            lone = len(order) - top == 1
            x = k * step_top if k < top else (top - 1) * 1.8 if lone else below * step_low
            places[node] = (x, 3.2 if k < top else 0.0)
    else:
        places = {node: (k * 3.6, 0.0) for k, node in enumerate(order)}
    centre = (sum(p[0] for p in places.values()) / len(places), sum(p[1] for p in places.values()) / len(places))
    for node in network.nodes:
        if node not in places:
            near = next((n for n in _neighbours(network, node) if n in places), order[0])
            x, y = places[near]
            while any(abs(x - a) < 2.4 and abs(y - b) < 1.0 for a, b in places.values()):
                x -= 3.4
            places[node] = (x, y)
    return places, centre


def _neighbours(network: Network, node: str) -> Iterable[str]:
    for e in network.elements:
        if node in e.nodes() and len(e.nodes()) > 1:
            yield from (n for n in e.nodes() if n != node)


def _outward(point: Point, centre: Point) -> float:
    """Return 1 where there is room above a box, -1 where there is room below."""
    return 1.0 if point[1] >= centre[1] else -1.0


def _volume(axes: Any, network: Network, node: str, at: Point) -> None:
    from matplotlib.patches import FancyBboxPatch

    x, y = at
    box = FancyBboxPatch(
        (x - _WIDE / 2, y - _HIGH / 2), _WIDE, _HIGH, boxstyle="round,pad=0.06", fc=FACE, ec=SOLID, lw=1.4, zorder=3
    )
    axes.add_patch(box)
    capacity = network.parameters[f"{node}.capacitance"].value
    axes.text(x, y + 0.11, node, ha="center", va="center", fontsize=10, weight="bold", zorder=4)
    axes.text(x, y - 0.17, f"{capacity / 1000.0:.3g} kJ/K", ha="center", va="center", fontsize=7.5, zorder=4)


def _water(axes: Any, network: Network, places: dict[str, Point]) -> None:
    pipes = {e.to: e for e in network.elements if isinstance(e, Pipe)}
    for flow in (e for e in network.elements if isinstance(e, Flow)):
        for node, before in flow.feeds().items():
            here = places[node]
            start = places[before] if before else (here[0] - 2.9, here[1])
            _arrow(axes, start, here, WATER, 2.2)
            middle = ((start[0] + here[0]) / 2, (start[1] + here[1]) / 2)
            if node in pipes:
                pipe = pipes[node]
                volume = network.parameters[f"{pipe.name}.volume"].value
                _tag(axes, middle, f"{pipe.name}\n{volume:g} L", WATER)
            if not before:
                axes.text(start[0] + 0.9, start[1] + 0.42, flow.inlet, color=DRIVE, fontsize=8, ha="center")


def _arrow(axes: Any, start: Point, end: Point, colour: str, width: float, **extra: Any) -> None:
    from matplotlib.patches import FancyArrowPatch

    level = abs(start[0] - end[0]) > abs(start[1] - end[1])
    trim = (_WIDE / 2 + 0.1, 0.0) if level else (0.0, _HIGH / 2 + 0.1)
    sx, sy = math.copysign(trim[0], end[0] - start[0]), math.copysign(trim[1], end[1] - start[1])
    axes.add_patch(
        FancyArrowPatch(
            (start[0] + sx, start[1] + sy),
            (end[0] - sx, end[1] - sy),
            arrowstyle=extra.pop("style", "-|>"),
            mutation_scale=14,
            color=colour,
            lw=width,
            zorder=1,
            shrinkA=0,
            shrinkB=0,
            **extra,
        )
    )


def _tag(axes: Any, at: Point, text: str, colour: str) -> None:
    box = {"boxstyle": "round,pad=0.2", "fc": "white", "ec": colour, "lw": 0.7}
    axes.text(*at, text, color=colour, fontsize=7.5, ha="center", va="center", zorder=2, bbox=box)


def _labels(
    network: Network, places: dict[str, Point]
) -> tuple[dict[str, list[tuple[str, str]]], dict[tuple[str, str], list[str]]]:
    """Return node -> (text, colour) of the elements that act on it alone, and (node, node) -> the elements that link
    them.
    """
    alone: dict[str, list[tuple[str, str]]] = {}
    between: dict[tuple[str, str], list[str]] = {}
    for e in network.elements:
        if e.kind in ("node", "flow", "pipe", "actuator", "law_actuator", "law_input", "limiter"):
            continue
        nodes = e.nodes()
        if isinstance(e, Sensor):
            columns = e.measured if len(e.measured) < 3 else (e.measured[0], "..", e.measured[-1])
            text = e.name if e.measured == (e.name,) else f"{e.name} = {', '.join(columns)}"
            alone.setdefault(e.node, []).append((f"reads {text}", READ))
        elif isinstance(e, LawReading):
            node = next(s.node for s in network.sensors if s.name == e.sensor)
            alone.setdefault(node, []).append((_named(network, e), READ))
        elif isinstance(e, LawFlow):
            path = next(f.path for f in network.elements if isinstance(f, Flow) and f.name == e.flow)
            alone.setdefault(path[0], []).append((_named(network, e), WATER))
        elif isinstance(e, Meter):
            at = next((n for other in network.elements if other.name == e.of for n in other.nodes()), "")
            alone.setdefault(at, []).append((f"reads {e.name}: {e.quantity} of {e.of}", READ))
        elif len(nodes) > 1:
            between.setdefault((nodes[0], nodes[1]), []).append(_named(network, e))
        elif nodes:
            alone.setdefault(nodes[0], []).append((_named(network, e), HEAT))
    return alone, between


def _named(network: Network, e: Element) -> str:
    """Return name, first parameter and drivers of an element; of a law its equation."""
    if isinstance(e, Law):
        return f"{e.name}  {law_equation(network, e).symbols}"
    specs = e.parameter_specs()
    value = ""
    if specs:
        p = network.parameters[f"{e.name}.{specs[0].name}"]
        value = f"  {p.value:.3g} {p.unit}" if p.unit != "1" else f"  x {p.value:.3g}"
    driven = [c for c in e.inputs() if c != network.room]
    return f"{e.name}{value}" + (f"  ({', '.join(driven)})" if driven else "")


def _beside(axes: Any, at: Point, side: float, labels: list[tuple[str, str]]) -> None:
    x, y = at
    for k, (text, colour) in enumerate(labels):
        level = y + side * (_HIGH / 2 + 0.26 + 0.24 * k)
        axes.text(x, level, text, color=colour, fontsize=7.5, ha="center", va="center", zorder=4)


def _link(axes: Any, a: Point, b: Point, texts: list[str], centre: Point) -> None:
    """Draw a dashed line that bows towards the middle of the picture, away from the water."""
    x, y = (a[0] + b[0]) / 2, (a[1] + b[1]) / 2
    level = a[1] == b[1]
    inward = (0.0, -_outward(a, centre)) if level else (math.copysign(1.0, centre[0] - x), 0.0)
    # the sign of an arc: positive bows to the right of the way from a to b
    across = (b[0] - a[0]) * inward[1] - (b[1] - a[1]) * inward[0]
    bend = math.copysign(0.3, -across)
    _arrow(axes, a, b, HEAT, 1.1, style="-", linestyle=(0, (4, 2)), connectionstyle=f"arc3,rad={bend}")
    depth = 0.15 * (abs(a[0] - b[0]) - _WIDE if level else abs(a[1] - b[1]) - _HIGH) + 0.14 + 0.1 * len(texts)
    side = "center" if level else "right" if inward[0] < 0.0 else "left"
    x, y = x + inward[0] * depth, y + inward[1] * depth
    axes.text(x, y, "\n".join(texts), color=HEAT, fontsize=7.5, ha=side, va="center", zorder=4)


def _legend(axes: Any, network: Network) -> None:
    names = [f"{c} ({s.unit})" if s.unit else c for c, s in network.inputs.items()]
    names += [f"{e.column} through {e.name}" for e in network.elements if isinstance(e, Actuator)]
    names += [_named(network, e) for e in network.elements if isinstance(e, LawActuator)]
    axes.text(0.0, 0.0, "inputs: " + ", ".join(names), transform=axes.transAxes, color=DRIVE, fontsize=8, va="bottom")
    for k, (text, colour) in enumerate((("read", READ), ("heat", HEAT), ("water", WATER))):
        axes.annotate(
            text, (1.0, 1.0), (-40 * k, 4), "axes fraction", "offset points", color=colour, fontsize=9, ha="right"
        )
