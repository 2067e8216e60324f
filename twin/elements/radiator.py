"""A fan-blown radiator, as a conductance or by its effectiveness.

    UA = UA_100 * fan^fan_exponent * flow^flow_exponent                fan and flow as shares of full

    form "outlet"          Q = (UA + UA_still) (T - T_amb)
    form "effectiveness"   Q = eps C_min (T_in - T_amb) + UA_still (T - T_amb)
                           NTU = UA / C_min,  C_r = C_min / C_max
                           eps = 1 - exp(NTU^0.22 / C_r * (exp(-C_r NTU^0.78) - 1))

T is the temperature of the node, which the water leaves with. "outlet" is the (hA)_r of Energies 2026, 19, 2452 when
UA_still = flow_exponent = 0 and the fan is constant; `flow_exponent` then also holds what the lumped outlet
temperature hides of the drop along the core. "effectiveness" needs the water's temperature before the core, and
follows both heat capacity rates: air through air_0 + (air_100 - air_0) * fan, water through flow_100.

Sources: fan affinity laws with a power law of the air-side film (Incropera, Fundamentals of Heat and Mass Transfer,
7th ed., sec. 7.6: exponents 0.5 to 0.8); effectiveness of a single-pass cross-flow core, both sides unmixed (ibid.,
eq. 11.32); `UA_still` is natural convection with the fan at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Fragment, Names, ParameterSpec, place
from twin.elements.stream import CP_WATER, flow_unit, kilograms_per_second

LEAST_PERCENT = 0.1
"""Speeds below this count as this much, so that a logarithm of a fan at rest is finite."""
CP_AIR = 1007.0
"""J/(kg K), dry air at 25 degC (Incropera table A.4)."""
LEAST_RATE = 1.0e-3
"""Least heat capacity rate, W/K: no flow at all carries no heat, without a division by zero."""


@dataclass(frozen=True)
class Radiator(Element):
    """Heat rejection to the room that follows fan and, if told so, pump."""

    kind: ClassVar[str] = "radiator"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("UA_100", "W/K", None, 0.0, 1.0e5, "tunable", "conductance at full fan and pump speed"),
        ParameterSpec("fan_exponent", "1", 0.5, 0.0, 2.0, "fixed", "0.5 to 0.8 for the air side, Incropera 7.6"),
        ParameterSpec("flow_exponent", "1", 0.0, -1.0, 1.0, "fixed", "0 where the water side does not limit"),
        ParameterSpec("UA_still", "W/K", 0.0, 0.0, 500.0, "fixed", "natural convection with the fan at rest"),
    )

    node: str = place("node", "node that is cooled")
    fan: str = place("input", "input column with the fan speed in %")
    pump: str = place("input", "input column with the pump speed in %, or with the flow of water")
    ambient: str = place("input", "input column with the room temperature in degC", default="T_ambient_C")
    form: str = place("choice", "law of the heat", choices=("outlet", "effectiveness"), default="outlet")
    inlet: str = place("node", "node that the water comes from (form effectiveness)", default="")
    supply: str = place("input", "input column with the water's inlet temperature, in place of `inlet`", default="")

    def nodes(self) -> tuple[str, ...]:
        return (self.node, self.inlet) if self.inlet else (self.node,)

    def inputs(self) -> tuple[str, ...]:
        drivers = (self.fan, self.pump, self.ambient)
        return (*drivers, self.supply) if self.supply else drivers

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        specs = self.parameters
        unit = flow_unit(self.pump)
        if unit and (self._in_flow_units() or self.form == "effectiveness"):
            specs += (ParameterSpec("flow_100", unit, None, 1.0e-3, 1.0e4, "fixed", "flow that counts as full"),)
        if self.form == "effectiveness":
            specs += (
                ParameterSpec("air_100", "kg/s", None, 1.0e-3, 1.0e3, "fixed", "air at full fan speed, fan curve"),
                ParameterSpec("air_0", "kg/s", 0.0, -100.0, 100.0, "fixed", "air with the fan at rest, extrapolated"),
                ParameterSpec("cp", "J/(kg K)", CP_WATER, 1000.0, 5000.0, "fixed", "water at 30 degC, IAPWS-95"),
            )
        return specs

    def problem(self, values: Mapping[str, float]) -> str | None:
        if values["UA_100"] == 0.0 and values["UA_still"] == 0.0:
            return "UA_100 and UA_still are both 0, so the radiator rejects nothing; remove it or give it a UA"
        if not flow_unit(self.pump):
            return f"pump {self.pump!r} is neither a speed nor a flow: end its name with _pct, _L_min, _m3_h or _kg_s"
        if self.form == "effectiveness" and bool(self.inlet) == bool(self.supply):
            return "give either `inlet`, the node that the water comes from, or `supply`, an input with its temperature"
        if self.form == "outlet" and (self.inlet or self.supply):
            return "`inlet` and `supply` belong to the form 'effectiveness'; set it or leave them out"
        return "the radiator is its own inlet" if self.inlet == self.node else None

    def emit(self, n: Names) -> Fragment:
        fan, pump, ua = n.local("log_fan"), n.local("log_pump"), n.local("UA")
        uniform = [(fan, f"log(max({n.input(self.fan)}, {LEAST_PERCENT}) * 0.01)")]
        exponent = f"{n.par('fan_exponent')} * {fan} + {n.par('flow_exponent')} * {pump}"
        flow = f"max({n.input(self.pump)}, {LEAST_PERCENT}) * 0.01"
        sample: list[tuple[str, str]] = []
        if self._in_flow_units():
            flow = f"max({n.input(self.pump)} / {n.par('flow_100')}, {LEAST_PERCENT * 0.01!r})"
            sample.append((pump, f"log({flow})"))
        else:
            uniform.append((pump, f"log({flow})"))
        still = f"{n.par('UA_still')} * ({n.input(self.ambient)} - {n.temperature(self.node)})"
        if self.form == "outlet":
            sample.append((ua, f"{n.par('UA_100')} * exp({exponent}) + {n.par('UA_still')}"))
            heat = f"{ua} * ({n.input(self.ambient)} - {n.temperature(self.node)})"
            return Fragment(tuple(uniform), tuple(sample), heat={self.node: heat}, conductance={self.node: ua})
        rate = n.local("rate")
        sample.append((ua, f"{n.par('UA_100')} * exp({exponent})"))
        sample += self._effective_rate(n, ua, rate)
        inlet = n.temperature(self.inlet) if self.inlet else n.input(self.supply)
        return Fragment(
            uniform=tuple(uniform),
            sample=tuple(sample),
            heat={self.node: f"{rate} * ({n.input(self.ambient)} - {inlet}) + {still}"},
            # The inlet's rate bounds that of a node whose water arrives through a flow path.
            conductance={self.node: f"{rate} + {n.par('UA_still')}"},
        )

    def _effective_rate(self, n: Names, ua: str, rate: str) -> list[tuple[str, str]]:
        """Expressions of eps * C_min, W/K, into the local name `rate`."""
        air, water, least, ratio, size = (n.local(name) for name in ("air", "water", "least", "ratio", "log_NTU"))
        share = f"max({n.input(self.fan)}, 0.0) * 0.01"
        blown = f"{n.par('air_0')} + ({n.par('air_100')} - {n.par('air_0')}) * {share}"
        flow = f"max({n.input(self.pump)}, 0.0)"
        if not self._in_flow_units():
            flow = f"{flow} * 0.01 * {n.par('flow_100')}"
        carried = f"{kilograms_per_second(flow_unit(self.pump), flow)} * {n.par('cp')}"
        both = f"exp(0.22 * {size}) / {ratio} * (exp(-{ratio} * exp(0.78 * {size})) - 1.0)"
        return [
            (air, f"max(({blown}) * {CP_AIR}, {LEAST_RATE})"),
            (water, f"max({carried}, {LEAST_RATE})"),
            (least, f"min({air}, {water})"),
            (ratio, f"max({least} / max({air}, {water}), 1.0e-6)"),
            (size, f"log(max({ua} / {least}, 1.0e-9))"),
            (rate, f"{least} * (1.0 - exp({both}))"),
        ]

    def _in_flow_units(self) -> bool:
        return not self.pump.endswith("_pct")
