"""Heat carried off by water that evaporates from a free surface into still air.

    Q = coefficient * area * (p_sat(T) - RH * p_sat(T_amb))
    p_sat(T) = 611.21 exp((18.678 - T / 234.5) T / (257.14 + T))        Pa, T in degC

Sources: the still-air evaporation rate of a water surface, 0.089 W/(m2 Pa) (Carrier's formula; ASHRAE Handbook HVAC
Applications, ch. Natatoriums, at zero air speed), in which the latent heat is contained; saturation pressure of
Buck, J. Appl. Meteorol. 20 (1981) 1527, as revised in 1996, within 0.1 % from 0 to 100 degC. A surface colder than
the dew point of the room condenses: the heat then flows in.

Temperatures count as within -40 to 100 degC in p_sat. The loss of water itself is not followed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment

_BOUND_PA_K = 1950.0
"""Slope of p_sat at 80 degC; the integrator's margin holds to boiling, where it is twice as steep."""


@dataclass(frozen=True)
class Evaporation(Element):
    """Evaporation from an open tank or a leak; there is none at area 0."""

    kind: ClassVar[str] = "evaporation"
    linear: ClassVar[bool] = False
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("area", "m2", None, 0.0, 10.0, "tunable", "open water surface"),
        ParameterSpec("coefficient", "W/(m2 Pa)", 0.089, 0.0, 1.0, "fixed", "still air, ASHRAE HVAC Applications"),
    )

    node: str = place("node", "node whose water evaporates")
    ambient: str = place("input", "input column with the room temperature in degC", unit="degC", default="T_ambient_C")
    humidity: str = place("input", "input column with the relative humidity in %, or a fixed one", unit="%", default="")

    def inputs(self) -> tuple[str, ...]:
        return (self.ambient, self.humidity) if self.humidity else (self.ambient,)

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        if self.humidity:
            return self.parameters
        spec = ParameterSpec("relative_humidity", "%", 50.0, 0.0, 100.0, "boundary", "of the room, where not measured")
        return (*self.parameters, spec)

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {e.node for e in sites.having(cls.kind)}
        humidity = [c for c in sites.inputs if "humidity" in c]
        driver = "humidity" if humidity else "temperature"
        extra = {"humidity": humidity[0]} if humidity else {}
        return tuple(
            Candidate(
                "heat_loss",
                sites.places[node],
                driver,
                "new",
                {f"{name}.area": 1.0},
                "m2",
                0.02,
                0.0,
                cls.upper_of("area"),
                "loses heat by evaporation from {value} of open water",
                adds={name: {"kind": cls.kind, "node": node, "ambient": sites.room, **extra}},
            )
            for node in sites.before
            if sites.room and node not in having and (name := f"evaporation_of_{node}")
        )

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where, now = sites.places[self.node], sites.values[f"{self.name}.area"]
        driver = "humidity" if self.humidity else "temperature"
        says = "loses heat by evaporation from {value} more of open water than when commissioned"
        return (
            self.parameter_candidate(
                "area", "heat_loss", where, driver, EffectSize("m2", 0.02, -now, self.upper_of("area") - now), says
            ),
        )

    def emit(self, n: Names) -> Fragment:
        room, air, water, pressure = (n.local(name) for name in ("room", "air", "water", "pressure"))
        strength, share = n.local("strength"), n.local("share")
        humidity = f"min(max({n.input(self.humidity)}, 0.0), 100.0)" if self.humidity else n.par("relative_humidity")
        return Fragment(
            uniform=((room, _clipped(n.input(self.ambient))), (air, saturation_pressure(room))),
            sample=((strength, f"{n.par('coefficient')} * {n.par('area')}"), (share, f"{humidity} * 0.01")),
            stage=((water, _clipped(n.temperature(self.node))), (pressure, saturation_pressure(water))),
            heat={self.node: f"{strength} * ({share} * {air} - {pressure})"},
            conductance={self.node: f"{_BOUND_PA_K} * {strength}"},
        )


def saturation_pressure(celsius: str) -> str:
    """Return the expression of the saturation pressure of water, Pa (Buck 1996)."""
    return f"611.21 * exp((18.678 - {celsius} / 234.5) * {celsius} / (257.14 + {celsius}))"


def _clipped(celsius: str) -> str:
    return f"min(max({celsius}, -40.0), 100.0)"
