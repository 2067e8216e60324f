"""Heat of unknown origin as a curve of a known quantity: straight lines between five knots.

    Q = q_1 + sum_k (q_(k+1) - q_k) (clip(u, x_k, x_(k+1)) - x_k) / (x_(k+1) - x_k)

u is an input column, or the temperature of a node. Outside the knots the curve keeps its last value. It names no cause:
a diagnosis offers it where no known effect explains the heat at a place, and an operator adopts it, or does not.

Source: piecewise-linear regression function; de Boor, A Practical Guide to Splines, rev. ed., ch. III.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.fragments import Fragment

KNOTS = 5
MOST_HEAT_W = 1.0e5
"""Largest heat of a curve, W, of either sign."""
FARTHEST_KNOT = 1.0e4
"""Largest number of the quantity that a curve follows, in its unit, of either sign."""


@dataclass(frozen=True)
class EmpiricalHeat(Element):
    """A heat input that follows an input column or a temperature by a fitted curve."""

    kind: ClassVar[str] = "empirical_heat"
    linear: ClassVar[bool] = False

    node: str = place("node", "node that gets the heat")
    driver: str = place("input", "input column that the heat follows", default="")
    of: str = place("node", "node whose temperature the heat follows instead", default="")

    def nodes(self) -> tuple[str, ...]:
        return (self.node, self.of) if self.of else (self.node,)

    def inputs(self) -> tuple[str, ...]:
        return (self.driver,) if self.driver else ()

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        suffix = self.driver.rsplit("_", 1)[-1] if self.driver else "C"
        unit = {"pct": "%", "C": "degC"}.get(suffix, suffix)
        where = tuple(
            ParameterSpec(f"x_{k}", unit, None, -FARTHEST_KNOT, FARTHEST_KNOT, "fixed", "knot") for k in _numbers()
        )
        heat = tuple(
            ParameterSpec(f"q_{k}", "W", None, -MOST_HEAT_W, MOST_HEAT_W, "fixed", "heat at the knot")
            for k in _numbers()
        )
        return (*where, *heat)

    def problem(self, values: Mapping[str, float]) -> str | None:
        if bool(self.driver) == bool(self.of):
            return "give either a driver column or a node (of) that the heat follows"
        knots = [values[f"x_{k}"] for k in _numbers()]
        if any(b <= a for a, b in zip(knots[:-1], knots[1:], strict=True)):
            return "the knots x_1 to x_5 must rise"
        return None

    def emit(self, n: Names) -> Fragment:
        u = n.input(self.driver) if self.driver else n.temperature(self.of)
        slopes = {k: n.local(f"slope_{k}") for k in range(1, KNOTS)}
        fixed = tuple(
            (
                slope,
                f"({n.par(f'q_{k + 1}')} - {n.par(f'q_{k}')}) / ({n.par(f'x_{k + 1}')} - {n.par(f'x_{k}')})",
            )
            for k, slope in slopes.items()
        )
        curve = n.par("q_1") + "".join(
            f" + {slope} * (min(max({u}, {n.par(f'x_{k}')}), {n.par(f'x_{k + 1}')}) - {n.par(f'x_{k}')})"
            for k, slope in slopes.items()
        )
        steep = " + ".join(f"max({slope}, -{slope})" for slope in slopes.values())
        return Fragment(
            sample=fixed,
            heat={self.node: curve},
            conductance={self.node: steep} if self.of == self.node else {},
        )


def _numbers() -> range:
    return range(1, KNOTS + 1)
