"""Fan-blown radiator, as a conductance or by its effectiveness.

    UA = UA_100 * fan^fan_exponent * flow^flow_exponent                fan and flow as shares of full

    form "outlet"          Q = (UA + UA_still) (T - T_amb)
    form "effectiveness"   Q = eps C_min (T_in - T_amb) + UA_still (T - T_amb)
                           NTU = UA / C_min,  C_r = C_min / C_max
                           eps = 1 - exp(NTU^0.22 / C_r * (exp(-C_r NTU^0.78) - 1))
    form "one_row"         Q = C_w (1 - exp(-K / C_w)) (T_in - T_amb) + UA_still (T - T_amb)
                           K = C_a (1 - exp(-UA / C_a))

A radiator that draws in its own warm air sees the room warmer by `recirculation` times the heat that it rejects:
UA and eps C_min are then divided by 1 + recirculation * themselves.

The share of the full flow is that of the pump's speed, times the factor of the flow path that the node stands on.

T is the temperature of the node, which the water leaves with. "outlet" is the (hA)_r of Energies 2026, 19, 2452 when
UA_still = flow_exponent = 0 and the fan is constant; `flow_exponent` then also contains the drop along the core, which
the lumped outlet temperature hides. The other two take the water as it arrives, T_in, and C_w = m cp from the node's
flow path. Their air flow is air_0 + (air_100 - air_0) * fan, with C_a its m cp; the share of the full air flow then
stands for the fan in UA. "effectiveness" is for a core of several rows; its slope has a kink at C_w = C_a, at which a
fit may stop. "one_row" is smooth.

Sources: fan affinity laws with a power law of the air-side film (Incropera, Fundamentals of Heat and Mass Transfer,
7th ed., sec. 7.6: exponents 0.5 to 0.8); effectiveness of a single-pass cross-flow core, both sides unmixed (ibid.,
eq. 11.32); of a single row of finned tubes, water mixed and air unmixed (ibid., eqs. 11.33a and 11.34a, which are
one formula in C_w and C_a); `UA_still` is natural convection with the fan at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment

LEAST_PERCENT = 0.1
"""Speed below which the radiator stays as at this one, %: the logarithm of a fan at rest is finite."""
CP_AIR = 1007.0
"""J/(kg K), dry air at 25 degC (Incropera table A.4)."""
LEAST_AIR = 1.0e-5
"""Least air flow as a share of the full one."""
LEAST_RATE = 1.0e-3
"""Least heat capacity rate, W/K: no flow at all carries no heat, without a division by zero."""


@dataclass(frozen=True)
class Radiator(Element):
    """Heat rejection to the room that follows fan and, with a flow exponent, pump."""

    kind: ClassVar[str] = "radiator"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("UA_100", "W/K", None, 0.0, 1.0e5, "tunable", "conductance at full fan and pump speed"),
        ParameterSpec("fan_exponent", "1", 0.5, 0.0, 2.0, "fixed", "0.5 to 0.8 for the air side, Incropera 7.6"),
        ParameterSpec("flow_exponent", "1", 0.0, -1.0, 1.0, "fixed", "0 where the water side does not limit"),
        ParameterSpec("UA_still", "W/K", 0.0, 0.0, 500.0, "fixed", "natural convection with the fan at rest"),
        ParameterSpec(
            "recirculation", "K/W", 0.0, 0.0, 1.0, "fixed", "warming of the air drawn in by the heat rejected"
        ),
    )

    node: str = place("node", "node that is cooled")
    fan: str = place("input", "input column with the fan speed in %", unit="%")
    pump: str = place("input", "input column with the pump speed in %", unit="%")
    ambient: str = place("input", "input column with the room temperature in degC", unit="degC", default="T_ambient_C")
    form: str = place("choice", "law of the heat", choices=("outlet", "effectiveness", "one_row"), default="outlet")

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        if self.form == "outlet":
            return self.parameters
        return (
            *self.parameters,
            ParameterSpec("air_100", "kg/s", None, 1.0e-3, 1.0e3, "fixed", "air at full fan speed, fan curve"),
            ParameterSpec("air_0", "kg/s", 0.0, -100.0, 100.0, "fixed", "air with the fan at rest, extrapolated"),
        )

    def problem(self, values: Mapping[str, float]) -> str | None:
        if values["UA_100"] == 0.0 and values["UA_still"] == 0.0:
            return "UA_100 and UA_still are both 0, so the radiator rejects nothing; remove it or give it a UA"
        return None

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where, now = sites.places[self.node], {k: sites.values[f"{self.name}.{k}"] for k in ("UA_100", "fan_exponent")}
        full, law = now["UA_100"], "with the fan's speed by a power that differs by {value}"
        rejects = ("heat_rejection", where)
        own, still = (sites.values[f"{self.name}.{key}"] for key in ("recirculation", "UA_still"))
        water = sites.values[f"{self.name}.flow_exponent"]
        # An "outlet" hides the drop along the core, and with it the effect of the flow.
        of_flow = self.parameter_candidate(
            "flow_exponent",
            *rejects,
            "pump_speed",
            EffectSize("1", 0.1, -1.0 - water, 1.0 - water),
            "rejects heat with the flow by a power that differs by {value}",
        )
        flows = () if self.form == "outlet" else (of_flow,)
        return (
            *flows,
            self.parameter_candidate(
                "UA_100",
                *rejects,
                "constant",
                EffectSize("W/K", 0.05 * full, -0.95 * full, 3.0 * full),
                "rejects heat with {value} more at full fan speed than when commissioned",
            ),
            self.parameter_candidate(
                "fan_exponent",
                *rejects,
                "fan_speed",
                EffectSize("1", 0.1, -now["fan_exponent"], 2.0 - now["fan_exponent"]),
                f"rejects heat {law}",
            ),
            self.parameter_candidate(
                "UA_still",
                *rejects,
                "constant",
                EffectSize("W/K", 1.0, -still, self.upper_of("UA_still") - still),
                "rejects {value} more than when commissioned whatever the fan does",
            ),
            replace(
                self.parameter_candidate(
                    "recirculation",
                    *rejects,
                    "rejected_heat",
                    EffectSize("K/W", 0.001, -own, 0.1 - own),
                    "draws in its own warm air: {value}",
                ),
                change="existing" if own else "new",
            ),
        )

    def emit(self, n: Names) -> Fragment:
        fan, pump, ua, still = n.local("log_fan"), n.local("log_pump"), n.local("UA"), n.par("UA_still")
        turning = (pump, f"log(max({n.input(self.pump)}, {LEAST_PERCENT}) * 0.01)")
        room, here = n.input(self.ambient), n.temperature(self.node)
        law = f"{n.par('UA_100')} * exp({n.par('fan_exponent')} * {fan} + {n.par('flow_exponent')} * {pump})"
        if self.node in n.streams and n.constant("flow_exponent") != 0.0:
            law += f" * exp({n.par('flow_exponent')} * log({n.of(n.streams[self.node].flow).par('factor')}))"
        recirculation, bare = n.par("recirculation"), n.local("bare")

        def behind_itself(conductance: str) -> str:
            return (
                conductance
                if n.constant("recirculation") == 0.0
                else f"{conductance} / (1.0 + {recirculation} * {conductance})"
            )

        if self.form == "outlet":
            return Fragment(
                uniform=((fan, f"log(max({n.input(self.fan)}, {LEAST_PERCENT}) * 0.01)"), turning),
                sample=((bare, f"{law} + {still}"), (ua, behind_itself(bare))),
                heat={self.node: f"{ua} * ({room} - {here})"},
                conductance={self.node: ua},
            )
        flow = n.of(n.streams[self.node].flow)
        air, air_100 = n.local("air"), n.par("air_100")
        blown = f"{n.par('air_0')} + ({air_100} - {n.par('air_0')}) * max({n.input(self.fan)}, 0.0) * 0.01"
        rate, arriving = n.local("rate"), n.local("arriving")
        rates = _one_row_rate if self.form == "one_row" else _effective_rate
        # The flow's own term is effectiveness * (w_in - T).
        share = flow.par(f"effectiveness_{self.node}")
        inlet = f"{here} + {flow.local(f'd_{self.node}')} * (1.0 / {share})"
        return Fragment(
            uniform=(turning,),
            sample=(
                (air, f"max({blown}, {LEAST_AIR} * {air_100})"),
                (fan, f"log({air} / {air_100})"),
                (ua, law),
                *rates(n, ua, f"{air} * {CP_AIR}", flow.local("mcp"), bare),
                (rate, behind_itself(bare)),
            ),
            stage=((arriving, inlet),),
            heat={self.node: f"{rate} * ({room} - {arriving}) + {still} * ({room} - {here})"},
            conductance={self.node: f"{rate} + {still}"},
        )


def _effective_rate(n: Names, ua: str, air: str, water: str, rate: str) -> list[tuple[str, str]]:
    """Return expressions of eps * C_min, W/K, into the local name `rate`, for two heat capacity rates in W/K."""
    least, most, ratio, size = (n.local(name) for name in ("least", "most", "ratio", "log_NTU"))
    both = f"exp(0.22 * {size}) / {ratio} * (exp(-{ratio} * exp(0.78 * {size})) - 1.0)"
    return [
        (least, f"max(min({air}, {water}), {LEAST_RATE})"),
        (most, f"max({air}, max({water}, {LEAST_RATE}))"),
        (ratio, f"max({least} / {most}, 1.0e-6)"),
        (size, f"log(max({ua} / {least}, 1.0e-9))"),
        (rate, f"{least} * (1.0 - exp({both}))"),
    ]


def _one_row_rate(n: Names, ua: str, air: str, water: str, rate: str) -> list[tuple[str, str]]:
    """Return expressions of C_w (1 - exp(-K / C_w)), W/K, into the local name `rate`, for two heat capacity rates in
    W/K.
    """
    least, taken = n.local("least"), n.local("taken")
    return [
        (least, f"max({water}, {LEAST_RATE})"),
        (taken, f"{air} * (1.0 - exp(-{ua} / ({air})))"),
        (rate, f"{least} * (1.0 - exp(-{taken} / {least}))"),
    ]
