"""A thermometer, or several whose mean is read as one: reading = T(node) + noise.

The noise of a mean of k thermometers is sigma / sqrt(k). Missing columns of a list are left out of the mean;
a sample with none left is masked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place


@dataclass(frozen=True)
class Sensor(Element):
    """What the record measures at a node; the element's name is the name of the sensor in every table."""

    kind: ClassVar[str] = "sensor"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("sigma", "K", 0.05, 1.0e-4, 10.0, "fixed", "standard deviation of one thermometer"),
    )

    node: str = place("node", "node whose temperature is read")
    measured: tuple[str, ...] = place("columns", "measured columns that are averaged", key="columns")

    def problem(self, values: Mapping[str, float]) -> str | None:
        bad = [column for column in self.measured if not column.endswith("_C")]
        if bad:
            return f"column {bad[0]!r} is not a temperature in degC: its name does not end in _C"
        return None

    def emit(self, n: Names) -> Fragment:
        return Fragment(observe=n.temperature(self.node))
