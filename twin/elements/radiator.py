"""A fan-blown radiator.

    UA = UA_100 * (fan/100)^fan_exponent * (pump/100)^flow_exponent + UA_still
    Q  = UA (T - T_amb)

Source: fan affinity laws with a power law of the air-side film (Incropera, Fundamentals of Heat and Mass
Transfer, 7th ed., sec. 7.6: exponents 0.5 to 0.8); `UA_still` is natural convection with the fan at rest.
`flow_exponent` holds what the water side adds and what the lumped outlet temperature hides of the drop along
the core. With UA_still = flow_exponent = 0 and a constant fan it is (hA)_r of Energies 2026, 19, 2452.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place

LEAST_PERCENT = 0.1
"""Speeds below this count as this much, so that a logarithm of a fan at rest is finite."""


@dataclass(frozen=True)
class Radiator(Element):
    """Heat rejection to the room that follows fan and, if told so, pump."""

    kind: ClassVar[str] = "radiator"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("UA_100", "W/K", None, 0.0, 5000.0, "tunable", "conductance at full fan and pump speed"),
        ParameterSpec("fan_exponent", "1", 0.5, 0.0, 2.0, "fixed", "0.5 to 0.8 for the air side, Incropera 7.6"),
        ParameterSpec("flow_exponent", "1", 0.0, -1.0, 1.0, "fixed", "0 where the water side does not limit"),
        ParameterSpec("UA_still", "W/K", 0.0, 0.0, 500.0, "fixed", "natural convection with the fan at rest"),
    )

    node: str = place("node", "node that is cooled")
    fan: str = place("input", "input column with the fan speed in %")
    pump: str = place("input", "input column with the pump speed in %")
    ambient: str = place("input", "input column with the room temperature in degC", default="T_ambient_C")

    def problem(self, values: Mapping[str, float]) -> str | None:
        if values["UA_100"] == 0.0 and values["UA_still"] == 0.0:
            return "UA_100 and UA_still are both 0, so the radiator rejects nothing; remove it or give it a UA"
        return None

    def emit(self, n: Names) -> Fragment:
        fan, pump, ua = n.local("log_fan"), n.local("log_pump"), n.local("UA")
        exponent = f"{n.par('fan_exponent')} * {fan} + {n.par('flow_exponent')} * {pump}"
        return Fragment(
            uniform=(
                (fan, f"log(max({n.input(self.fan)}, {LEAST_PERCENT}) * 0.01)"),
                (pump, f"log(max({n.input(self.pump)}, {LEAST_PERCENT}) * 0.01)"),
            ),
            sample=((ua, f"{n.par('UA_100')} * exp({exponent}) + {n.par('UA_still')}"),),
            heat={self.node: f"{ua} * ({n.input(self.ambient)} - {n.temperature(self.node)})"},
            conductance={self.node: ua},
        )
