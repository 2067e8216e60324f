"""Wet cooling tower by Merkel's method, effectiveness and NTU.

    Me  = Me_100 * flow^flow_exponent * air^fan_exponent               flow and air as shares of full
    NTU = Me m_w / m_a,   m* = m_a C_s / (m_w cp)
    eps = (1 - exp(-NTU (1 - m*))) / (1 - m* exp(-NTU (1 - m*)))
    Q   = eps m_a (h_s(T_in) - h_in)

T_in is the water as it arrives, h_s the enthalpy of saturated air, h_in that of the air outside. C_s = dh_s/dT halfway
between the incoming water and the node, which is the water that leaves (for a range of 15 K within 3 % of the chord).
Merkel's own law of the fill, Me = c (m_w / m_a)^-n, is flow_exponent = -n and fan_exponent = n. The air flow is
air_0 + air_1 f + air_2 f^2 with f the fan's speed as a share of full. Evaporated water stays in the flow, as in
Merkel's method.

Sources: Braun, Klein & Mitchell, ASHRAE Trans. 95 (1989) 164 (effectiveness with a saturation slope); Merkel, VDI
Forschungsarbeiten 275 (1925); Kloppers & Kroeger, Int. J. Heat Mass Transfer 48 (2005) 765 (the law of the fill);
Magnus formula with the coefficients of WMO-No. 8.

Saturated air is taken at 0 to 80 degC; the bound on the dependence of Q on the node's own temperature is that of C_s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.flow import LEAST_PERCENT, WATER_DENSITY
from twin.elements.fragments import Fragment

CP_DRY, CP_STEAM, LATENT = 1006.0, 1860.0, 2.501e6
"""J/(kg K), J/(kg K), J/kg at 0 degC."""
LEAST_AIR = 1.0e-3
"""kg/s of air that always passes."""
HOTTEST_C = 80.0
_STEEP = 2.0e4
"""W/K for 1 kg/s of air: a bound on dQ/dT, from 3 % of saturated air's 600 kJ/kg at 60 degC."""
_LONGEST = 50.0


@dataclass(frozen=True)
class Tower(Element):
    """Heat taken from water by air that it wets."""

    kind: ClassVar[str] = "tower"
    linear: ClassVar[bool] = False
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("Me_100", "1", None, 0.0, 20.0, "tunable", "Merkel number at full flow and air"),
        ParameterSpec("flow_exponent", "1", 0.0, -2.0, 2.0, "fixed", "-0.4 to -0.8 for most fills, Kloppers"),
        ParameterSpec("fan_exponent", "1", 0.0, -2.0, 2.0, "fixed", "0.4 to 0.8 for most fills, Kloppers"),
        ParameterSpec("air_0", "kg/s", 0.0, -1.0e3, 1.0e3, "fixed", "air with the fan at rest, extrapolated"),
        ParameterSpec("air_1", "kg/s", None, 0.0, 1.0e4, "fixed", "of the fan's speed, fan curve"),
        ParameterSpec("air_2", "kg/s", 0.0, -1.0e4, 1.0e4, "fixed", "of its square, fan curve"),
        ParameterSpec("pressure", "kPa", 101.3, 60.0, 110.0, "fixed", "air pressure at the site"),
    )

    node: str = place("node", "node that the cooled water leaves from; on a flow path")
    fan: str = place("input", "input column with the fan speed in %", unit="%")
    pump: str = place("input", "input column with the pump speed in %", unit="%")
    humidity: str = place("input", "input column with the relative humidity in %", unit="%")
    ambient: str = place("input", "input column with the air temperature in degC", unit="degC", default="T_ambient_C")

    def problem(self, values: Mapping[str, float]) -> str | None:
        full = values["air_0"] + values["air_1"] + values["air_2"]
        return None if full > 0.0 else f"the air flow at full fan speed is {full:g} kg/s; it must be above 0"

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        rejects = ("heat_rejection", sites.places[self.node])
        now = {k: sites.values[f"{self.name}.{k}"] for k in ("Me_100", "flow_exponent", "fan_exponent")}
        says = "rejects heat with {driver} by a power that differs by {{value}}"
        number = self.parameter_candidate(
            "Me_100",
            *rejects,
            "constant",
            EffectSize("1", 0.05 * now["Me_100"], -0.9 * now["Me_100"], 3.0 * now["Me_100"]),
            "has another Merkel number: a change by {value}",
        )
        powers = (
            self.parameter_candidate(
                name,
                *rejects,
                driver,
                EffectSize("1", 0.1, -2.0 - now[name], 2.0 - now[name]),
                says.format(driver=words),
            )
            for name, driver, words in (
                ("fan_exponent", "fan_speed", "the air"),
                ("flow_exponent", "pump_speed", "the water's flow"),
            )
        )
        ratio = Candidate(
            *rejects,
            "flow_ratio",
            "existing",
            {f"{self.name}.flow_exponent": -1.0, f"{self.name}.fan_exponent": 1.0},
            "1",
            0.1,
            0.0,
            1.5,
            "rejects heat with the ratio of air to water by a power that differs by {value}",
        )
        return (number, ratio, *powers)

    def emit(self, n: Names) -> Fragment:
        flow = n.of(n.streams[self.node].flow)
        fan, log_pump, water, air = n.local("fan"), n.local("log_pump"), n.local("water"), n.local("air")
        full, ntu, outside, rate = n.local("full"), n.local("ntu"), n.local("outside"), n.local("rate")
        vapour, here, arriving = n.local("vapour"), n.temperature(self.node), n.local("arriving")
        pressure = f"(1000.0 * {n.par('pressure')})"
        a0, a1, a2 = (n.par(f"air_{k}") for k in range(3))
        uniform = (
            (fan, f"max({n.input(self.fan)}, 0.0) * 0.01"),
            (log_pump, f"log(max({n.input(self.pump)}, {LEAST_PERCENT}) * 0.01)"),
            (vapour, f"min(max({n.input(self.humidity)}, 0.0), 100.0) * 0.01 * {_saturated(n.input(self.ambient))}"),
        )
        law = f"{n.par('flow_exponent')} * {log_pump} + {n.par('fan_exponent')} * log({air} / {full})"
        sample = (
            (full, f"max({a0} + {a1} + {a2}, {LEAST_AIR})"),
            (air, f"max({a0} + {fan} * ({a1} + {a2} * {fan}), {LEAST_AIR})"),
            (water, f"max({flow.local('q')} * {WATER_DENSITY!r}, {LEAST_AIR})"),
            (ntu, f"{n.par('Me_100')} * exp(min({law}, {_LONGEST})) * {water} / {air}"),
            (rate, f"{air} / max({flow.local('mcp')}, 1.0)"),
            (outside, _enthalpy(n.input(self.ambient), f"0.622 * {vapour} / ({pressure} - {vapour})")),
        )
        mid, steam, moist, slope = n.local("mid"), n.local("steam"), n.local("moist"), n.local("slope")
        m, x, y, through = n.local("m"), n.local("x"), n.local("y"), n.local("through")
        hot, top, q = n.local("hot"), n.local("top"), n.local("Q")
        share = flow.par(f"effectiveness_{self.node}")
        rises = f"{steam} * {17.62 * 243.12!r} / (({mid} + 243.12) * ({mid} + 243.12))"
        stage = (
            (arriving, f"{here} + {flow.local(f'd_{self.node}')} * (1.0 / {share})"),
            (mid, f"min(max(0.5 * ({arriving} + {here}), 0.0), {HOTTEST_C})"),
            (steam, _saturated(mid)),
            (moist, f"0.622 * {steam} / ({pressure} - {steam})"),
            (
                slope,
                f"{CP_DRY} + {CP_STEAM} * {moist} + ({LATENT} + {CP_STEAM} * {mid}) * {moist} * {pressure} "
                f"/ ({steam} * ({pressure} - {steam})) * {rises}",
            ),
            (m, f"{rate} * {slope}"),
            (x, f"{ntu} * (1.0 - {m})"),
            (y, f"max(max({x}, -{x}), 1e-6)"),
            # NTU (1 - exp(-x)) / x, whichever way round the two flows are.
            (through, f"{ntu} * (1.0 - exp(-min({y}, {_LONGEST}))) / {y} * exp(min(max(-{x}, 0.0), {_LONGEST}))"),
            (hot, f"min(max({arriving}, 0.0), {HOTTEST_C})"),
            (top, _saturated(hot)),
            (
                q,
                f"{air} * {through} / (1.0 + {m} * {through}) * "
                f"({_enthalpy(hot, f'0.622 * {top} / ({pressure} - {top})')} - {outside})",
            ),
        )
        return Fragment(
            uniform=uniform,
            sample=sample,
            stage=stage,
            heat={self.node: f"-{q}"},
            conductance={self.node: f"{_STEEP} * {air}"},
        )


def _saturated(celsius: str) -> str:
    """Return the pressure of saturated steam over water, Pa, between 0 and 80 degC."""
    t = f"min(max({celsius}, 0.0), {HOTTEST_C})"
    return f"611.2 * exp(17.62 * ({t}) / (({t}) + 243.12))"


def _enthalpy(celsius: str, moisture: str) -> str:
    """Return the enthalpy of moist air, J/kg of dry air."""
    return f"({CP_DRY} * ({celsius}) + ({moisture}) * ({LATENT} + {CP_STEAM} * ({celsius})))"
