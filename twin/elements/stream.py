"""Water that enters from outside, passes nodes one after the other and leaves.

    m = factor * column                              (or nominal * pump/100 * factor for a speed in %)
    heat into node j = m * cp * (T_(j-1) - T_j),     T_0 = supply, each node well mixed

Source: the advective term of eq. 1 of Energies 2026, 19, 2452, with a measured inlet in place of the ring. For a
closed loop take `flow`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place

WATER_DENSITY = 0.997
"""kg/L at 25 degC (IAPWS-95)."""
CP_WATER = 4180.0
"""J/(kg K) at 30 degC (IAPWS-95)."""
_PER_SECOND = {"kg/s": 1.0, "L/min": WATER_DENSITY / 60.0, "m3/h": WATER_DENSITY / 3.6}
_ENDINGS = {"_pct": "L/min", "_L_min": "L/min", "_m3_h": "m3/h", "_kg_s": "kg/s"}


def flow_unit(column: str) -> str:
    """Unit of a flow by the ending of its column, "" for none; a speed in % scales a flow in L/min."""
    return next((unit for ending, unit in _ENDINGS.items() if column.endswith(ending)), "")


def kilograms_per_second(unit: str, expression: str) -> str:
    """Expression of a mass flow in kg/s from one in `unit`."""
    return f"{_PER_SECOND[unit]!r} * {expression}"


@dataclass(frozen=True)
class Stream(Element):
    """A once-through flow with measured inlet temperature."""

    kind: ClassVar[str] = "stream"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("factor", "1", 1.0, 0.2, 3.0, "fixed", "true flow over measured flow"),
        ParameterSpec("cp", "J/(kg K)", CP_WATER, 1000.0, 5000.0, "fixed", "water at 30 degC, IAPWS-95"),
    )

    path: tuple[str, ...] = place("nodes", "nodes in the order in which the water meets them")
    pump: str = place("input", "input column with the flow of water, or the pump speed in %")
    supply: str = place("input", "input column with the temperature at which the water enters")

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        if self.pump.endswith("_pct"):
            spec = ParameterSpec("nominal", "L/min", None, 0.01, 1.0e4, "boundary", "flow at 100 % speed, data sheet")
            return (*self.parameters, spec)
        return self.parameters

    def problem(self, values: Mapping[str, float]) -> str | None:
        if len(set(self.path)) != len(self.path):
            return "the path names a node twice"
        if not flow_unit(self.pump):
            return f"pump {self.pump!r} is neither a speed nor a flow: end its name with _pct, _L_min, _m3_h or _kg_s"
        return None

    def emit(self, n: Names) -> Fragment:
        mcp = n.local("mcp")
        flow = f"max({n.input(self.pump)}, 0.0)"
        if self.pump.endswith("_pct"):
            flow = f"{flow} * 0.01 * {n.par('nominal')}"
        rate = f"{kilograms_per_second(flow_unit(self.pump), flow)} * {n.par('factor')} * {n.par('cp')}"
        before = (n.input(self.supply), *(n.temperature(node) for node in self.path[:-1]))
        return Fragment(
            sample=((mcp, rate),),
            heat={
                node: f"{mcp} * ({inlet} - {n.temperature(node)})"
                for node, inlet in zip(self.path, before, strict=True)
            },
            conductance=dict.fromkeys(self.path, mcp),
        )
