"""Effect on a tower cell that its clean twin lacks, as a diagnosis found it: a path, a driver and a size.

    x(t) = size * driver(t) from the onset on

`hil tower calibrate` solves the cell with it by `twin.tower.effects`, where paths and drivers are defined. A free run
of the network leaves it out: the drivers of a tower record, as the wind's direction, are no inputs of the network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.fragments import Fragment

KINDS = ("recirculation", "neighbour", "bypass_leak", "solar", "underwetting", "follows")
"""Names of the effects among which a diagnosis chooses: those of `twin.tower.diagnosis.candidates`."""
PATHS = ("exhaust", "past_fill", "wetted", "outlet", "inlet", "wet_bulb", "water")
DRIVERS = ("always", "wind_direction", "wind_speed", "neighbours_speed", "solar", "low_flow", "column")
"""Paths and drivers as in `twin.tower.effects`."""


@dataclass(frozen=True)
class TowerEffect(Element):
    """An undeclared effect of a tower cell, with the size that a diagnosis estimated."""

    kind: ClassVar[str] = "tower_effect"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("size", "1", 0.0, -100.0, 100.0, "fixed", "size where the driver is 1; K for readings"),
        ParameterSpec("sd", "1", 0.0, 0.0, 100.0, "fixed", "standard deviation of the size"),
        ParameterSpec("form", "1", 0.0, -1.0e4, 1.0e4, "fixed", "direction in deg, hour of noon UTC, or share of flow"),
        ParameterSpec("centre", "1", 0.0, -1.0e9, 1.0e9, "fixed", "value of the column at which it does not act"),
        ParameterSpec("spread", "1", 1.0, 1.0e-9, 1.0e9, "fixed", "change of the column that counts as 1"),
        ParameterSpec("onset_s", "s", 0.0, 0.0, 1.0e11, "fixed", "since when, s since 1970; 0 is all along"),
    )

    node: str = place("node", "node of the outlet flume")
    effect: str = place("choice", "name of the effect", choices=KINDS)
    path: str = place("choice", "what it moves", choices=PATHS)
    driver: str = place("choice", "what drives it", choices=DRIVERS)
    column: str = place("input", "column that drives it, for the driver column", default="")

    def inputs(self) -> tuple[str, ...]:
        return (self.column,) if self.column else ()

    def emit(self, n: Names) -> Fragment:
        return Fragment()
