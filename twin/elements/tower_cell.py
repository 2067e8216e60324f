"""A cell of a cooling tower at rest: the water in its outlet flume as a function of inputs and deviations alone.

    t_fill  = Merkel's method in the effectiveness-NTU form, a fixed point of 6 passes; see `twin.tower.cell`
    t_mixed = (1 - b) t_fill + b T_in,   b = bypass_share * bypass/100
    heat into the flume's node = m_w c_p (t_mixed - T_node)

The fill holds so little water that it follows its inputs at once, so the fixed point is computed once for each sample
and the network stays affine in its temperatures. `fill`, `air` and `uniformity` are deviations from the clean cell:
multipliers of its Merkel number, of its air flow at full speed and of the wetted share of its plan at design flow.

Sources: Braun, Klein & Mitchell, ASHRAE Trans. 95 (1989) 164; Kloppers & Kroeger, Int. J. Heat Mass Transfer 48
(2005) 765; saturation by Hyland & Wexler, ASHRAE Handbook Fundamentals 2017, chapter 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Export, Fragment

CP_DRY, CP_STEAM, LATENT, CP_WATER = 1006.0, 1860.0, 2.501e6, 4186.0
"""J/(kg K) of dry air and vapour, J/kg at 0 degC, J/(kg K) of water."""
WETTED, STARVING, PASSES, LEAST_AIR = 0.94, 1.5, 6, 0.02
"""As in `twin.tower.cell`; a test holds the two equal."""
NEWTON = 6
"""Newton's steps for the temperature of saturated air of a given enthalpy: the error is below 1e-6 K."""
COLDEST_C, HOTTEST_C = -30.0, 80.0
"""Temperatures between which saturated air is evaluated."""
_LONGEST = 50.0


@dataclass(frozen=True)
class TowerCell(Element):
    """Fill, fan and bypass of one cell, with its deviations from the clean cell."""

    kind: ClassVar[str] = "tower_cell"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("water_flow", "kg/s", None, 0.01, 1.0e5, "fixed", "design water flow"),
        ParameterSpec("air_flow", "kg/s", None, 0.01, 1.0e5, "fixed", "air flow of the clean cell at full fan speed"),
        ParameterSpec("density", "kg/m3", 1.15, 0.5, 2.0, "fixed", "of the air at which the air flow was measured"),
        ParameterSpec("merkel", "1", None, 0.05, 20.0, "fixed", "Merkel number of the clean cell at design flows"),
        ParameterSpec("exponent", "1", 0.6, 0.0, 2.0, "fixed", "of water over air in the Merkel number, Kloppers"),
        ParameterSpec("fan_power", "kW", 0.0, 0.0, 1.0e5, "fixed", "of the shaft at full speed and that density"),
        ParameterSpec("fan_idle", "kW", 0.0, 0.0, 1.0e5, "fixed", "losses of motor and drive at any speed"),
        ParameterSpec("kappa", "1", 0.0, -5.0, 5.0, "fixed", "fan power goes with the air to the power -kappa"),
        ParameterSpec("evaporation", "1", 1.0, 0.5, 2.0, "fixed", "evaporation over that of Merkel's method"),
        ParameterSpec("bypass_share", "1", 0.0, 0.0, 1.0, "fixed", "of the water that an open bypass valve lets past"),
        ParameterSpec("error_K", "K", 0.1, 0.001, 5.0, "fixed", "RMSE of the clean cell at its test points"),
        ParameterSpec(
            "merkel_sd", "1", 0.02, 1e-4, 1.0, "fixed", "standard deviation of the Merkel number's logarithm"
        ),
        ParameterSpec("exponent_sd", "1", 0.1, 1e-4, 1.0, "fixed", "standard deviation of the exponent"),
        ParameterSpec("fill", "1", 1.0, 0.2, 1.8, "fixed", "Merkel number over that of the clean cell"),
        ParameterSpec("air", "1", 1.0, 0.2, 1.8, "fixed", "air flow over that of the clean cell"),
        ParameterSpec(
            "uniformity", "1", 1.0, 0.2, 1.8, "fixed", "wetted share of the plan over that of the clean cell"
        ),
    )

    node: str = place("node", "node of the outlet flume")
    inlet: str = place("input", "input column with the temperature of the hot water in degC", unit="degC")
    water: str = place("input", "input column with the water flow in kg/s", unit="kg/s")
    fan: str = place("input", "input column with the fan speed in %", unit="%")
    dry: str = place("input", "input column with the dry bulb in degC", unit="degC")
    wet: str = place("input", "input column with the wet bulb in degC", unit="degC")
    pressure: str = place("input", "input column with the barometric pressure in kPa", unit="kPa")
    bypass: str = place("input", "input column with the position of the bypass valve in %", unit="%")

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        place_of = sites.places[self.node]
        says = {
            "fill": "has a fill whose Merkel number differs by {value}",
            "air": "gets an air flow that differs by {value}",
            "uniformity": "has a wetted share of its plan that differs by {value}",
        }
        found = []
        for name, words in says.items():
            now = sites.values[f"{self.name}.{name}"]
            size = EffectSize("1", 0.05, 0.2 - now, 1.8 - now)
            found.append(self.parameter_candidate(name, "heat_rejection", place_of, "constant", size, words))
        return tuple(found)

    def emit(self, n: Names) -> Fragment:
        t_in = f"min(max({n.input(self.inlet)}, 0.0), {HOTTEST_C})"
        names = ["t_in", "dry", "wet", "kPa", "w_in", "h_in", "rho_air", "fan_share", "hot", "h_hot", "m_w"]
        uniform = {name: n.local(name) for name in names}
        dry, wet, kpa = uniform["dry"], uniform["wet"], uniform["kPa"]
        saturated, frozen = _ratio(wet, kpa), _ratio_over_ice(wet, kpa)
        below = f"({dry} - {wet})"
        over_water = (
            f"((2501.0 - 2.326 * {wet}) * {saturated} - 1.006 * {below}) / (2501.0 + 1.86 * {dry} - 4.186 * {wet})"
        )
        over_ice = f"((2830.0 - 0.24 * {wet}) * {frozen} - 1.006 * {below}) / (2830.0 + 1.86 * {dry} - 2.1 * {wet})"
        icy = n.local("icy")
        first = (
            (uniform["t_in"], t_in),
            (dry, f"min(max({n.input(self.dry)}, {COLDEST_C}), 60.0)"),
            (wet, f"min(max({n.input(self.wet)}, {COLDEST_C}), {dry})"),
            (kpa, f"max({n.input(self.pressure)}, 50.0)"),
            (icy, f"min(max(-{wet} * 1e6, 0.0), 1.0)"),
            (uniform["w_in"], f"max({icy} * ({over_ice}) + (1.0 - {icy}) * ({over_water}), 0.0)"),
            (uniform["h_in"], _enthalpy(dry, uniform["w_in"])),
            (
                uniform["rho_air"],
                f"{kpa} * (1.0 + {uniform['w_in']}) / (0.287042 * ({dry} + 273.15) * (1.0 + 1.607858 * "
                f"{uniform['w_in']}))",
            ),
            (uniform["fan_share"], f"max({n.input(self.fan)} * 0.01, {LEAST_AIR})"),
            (uniform["h_hot"], _enthalpy(uniform["t_in"], _ratio(uniform["t_in"], kpa))),
            (uniform["m_w"], f"max({n.input(self.water)}, 1e-3)"),
        )
        sample, fill_out = self._fixed_point(n, uniform)
        share = f"({n.par('bypass_share')} * min(max({n.input(self.bypass)} * 0.01, 0.0), 1.0))"
        mixed, mcp = n.local("mixed"), n.local("mcp")
        sample += [
            (mixed, f"{fill_out} + {share} * ({uniform['t_in']} - {fill_out})"),
            (mcp, f"{CP_WATER} * max({n.input(self.water)}, 0.0)"),
        ]
        return Fragment(
            uniform=first,
            sample=tuple(sample),
            heat={self.node: f"{mcp} * ({mixed} - {n.temperature(self.node)})"},
            conductance={self.node: mcp},
            exports=self._exports(n, uniform, fill_out),
        )

    def _exports(self, n: Names, u: Mapping[str, str], fill_out: str) -> dict[str, Export]:
        """Return heat rejected, fan power and evaporation, as `twin.tower.cell` has them."""
        par, water, wet_air = n.par, n.local("water"), n.local("wet_air")
        share, surface, slope = n.local("wet_share"), n.local("surface"), n.local("surface_slope")
        at = n.local("surface_t")
        steps = [
            (share, f"1.0 - exp(-min({n.local('ntu')}, {_LONGEST}))"),
            (surface, f"{u['h_in']} + ({u['t_in']} - {fill_out}) * {water} * {CP_WATER} / ({wet_air} * {share})"),
            (at, f"min(max(({surface} - 1.0e4) / 3.0e3, -10.0), 60.0)"),
        ]
        for k in range(NEWTON):
            h, following = n.local(f"surface_h{k}"), n.local(f"surface_t{k}")
            warmer = f"({at} + 0.01)"
            steps += [
                (h, _enthalpy(at, _ratio(at, u["kPa"]))),
                (f"{slope}{k}", f"({_enthalpy(warmer, _ratio(warmer, u['kPa']))} - {h}) * 100.0"),
                (following, f"min(max({at} - ({h} - {surface}) / {slope}{k}, {COLDEST_C}), {HOTTEST_C})"),
            ]
            at = following
        lost = f"{par('evaporation')} * {wet_air} * {share} * ({_ratio(at, u['kPa'])} - {u['w_in']})"
        speed = n.local("speed")
        shaft = f"{par('fan_power')} * {speed} * {speed} * {speed} * {u['rho_air']} / {par('density')}"
        return {
            "heat_rejected": Export("kW", f"0.001 * {n.local('mcp')} * ({u['t_in']} - {n.local('mixed')})"),
            "fan_power": Export(
                "kW",
                f"{par('fan_idle')} + {shaft} * exp(-{par('kappa')} * log({par('air')}))",
                ((speed, u["fan_share"]),),
            ),
            "evaporation": Export("kg/s", lost, tuple(steps)),
        }

    def _fixed_point(self, n: Names, u: Mapping[str, str]) -> tuple[list[tuple[str, str]], str]:
        """Return the locals of the fixed point and the name of the temperature of the water that leaves the fill."""
        par, t_in, kpa = n.par, u["t_in"], u["kPa"]
        water, wetted, wet_air, loading, ntu = (n.local(k) for k in ("water", "wetted", "wet_air", "loading", "ntu"))
        design = f"{par('water_flow')} / {water}"
        rows = [
            (water, f"max({u['m_w']}, 1e-3 * {par('water_flow')})"),
            (
                wetted,
                f"min(max(1.0 - (1.0 - {WETTED} * {par('uniformity')}) * exp({STARVING} * log({design})), 0.05), 1.0)",
            ),
            (
                wet_air,
                f"{wetted} * {par('air_flow')} * {par('air')} * {u['fan_share']} * {u['rho_air']} / {par('density')}",
            ),
            (loading, f"{water} / {wet_air}"),
            (
                ntu,
                f"{par('fill')} * {par('merkel')} * {loading} * exp(-{par('exponent')} * "
                f"log({loading} * {WETTED} * {par('air_flow')} / {par('water_flow')}))",
            ),
        ]
        before = f"(0.5 * ({t_in} + {u['wet']}))"
        for k in range(PASSES):
            fall, slope, m, x, y = (n.local(f"{name}{k}") for name in ("fall", "slope", "m", "x", "y"))
            through, out = n.local(f"through{k}"), n.local(f"out{k}")
            apart, near = n.local(f"apart{k}"), n.local(f"near{k}")
            cold = f"({t_in} - {fall})"
            rows += [
                (apart, f"{t_in} - {before}"),
                # A fall of less than 0.05 K counts as 0.05 K, as in `twin.tower.cell`.
                (near, f"min(max((0.05 - max({apart}, -{apart})) * 1e9, 0.0), 1.0)"),
                (fall, f"{near} * 0.05 + (1.0 - {near}) * {apart}"),
                (slope, f"({u['h_hot']} - {_enthalpy(cold, _ratio(cold, kpa))}) / {fall}"),
                (m, f"{wet_air} * {slope} / ({water} * {CP_WATER})"),
                (x, f"{ntu} * (1.0 - {m})"),
                (y, f"max(max({x}, -{x}), 1e-6)"),
                # NTU (1 - exp(-x)) / x, whichever way round the two flows are.
                (through, f"{ntu} * (1.0 - exp(-min({y}, {_LONGEST}))) / {y} * exp(min(max(-{x}, 0.0), {_LONGEST}))"),
                (
                    out,
                    f"{t_in} - {through} / (1.0 + {m} * {through}) * {wet_air} * ({u['h_hot']} - {u['h_in']}) "
                    f"/ ({water} * {CP_WATER})",
                ),
            ]
            before = out
        return rows, before


def _enthalpy(celsius: str, ratio: str) -> str:
    """Return the enthalpy of moist air, J per kg of dry air."""
    return f"({CP_DRY} * {celsius} + {ratio} * ({LATENT} + {CP_STEAM} * {celsius}))"


def _ratio(celsius: str, kpa: str) -> str:
    """Return the humidity ratio of saturated air."""
    saturated = _saturated(celsius)
    return f"(0.621945 * {saturated} / ({kpa} - {saturated}))"


def _ratio_over_ice(celsius: str, kpa: str) -> str:
    """Return the humidity ratio of air saturated over ice."""
    k = f"(min(max({celsius}, {COLDEST_C}), 0.0) + 273.15)"
    pressure = (
        f"exp(-5674.5359 / {k} + 6.3925247 - 6.9077552789821368 + {k} * (-9.677843e-3 + {k} * (6.2215701e-7 + {k} * "
        f"(2.0747825e-9 - 9.484024e-13 * {k}))) + 4.1635019 * log({k}))"
    )
    return f"(0.621945 * {pressure} / ({kpa} - {pressure}))"


def _saturated(celsius: str) -> str:
    """Return the pressure of saturated vapour over water, kPa."""
    k = f"(min(max({celsius}, {COLDEST_C}), {HOTTEST_C}) + 273.15)"
    return (
        f"exp(-5800.2206 / {k} + 1.3914993 - 6.9077552789821368 + {k} * (-0.048640239 + {k} * (4.1764768e-5 - "
        f"1.4452093e-8 * {k})) + 6.5459673 * log({k}))"
    )
