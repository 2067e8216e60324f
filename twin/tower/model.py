"""Outlet and fan of a cell with its deviations and with what is uncertain about the twin itself.

The deviations `SLOW` change in time; the `GLOBAL` quantities are constants of a record. They are what Merkel's
method, the test points and the station's instruments leave open, each with a prior from physics or from the
instrument. So the structural error of the twin is a function of the operating point that a fit can separate from a
slow deviation:

    air flow by fan, buoyancy and wind                                                     `twin.tower.air_flow`
    Me             *= (1 + fill_share fill) exp(merkel) (T_in/T_in0)^inlet (L/G)^-exponent    law of the fill
    T_wb at the fill = T_wb + (recirculation + wind terms) (T_exhaust - T_wb)              recirculation
    t_out          += sum of weights times smooth functions of the operating point         discrepancy (Kennedy &
    O'Hagan)

The smooth functions vanish at design, where the clean cell was measured, so there they are no fouling.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from twin.tower import air as moist
from twin.tower.air import Array
from twin.tower.air_flow import CALM, LEAST_WAY, effective_speed, exhaust_density, exhaust_density_at
from twin.tower.cell import KAPPA, STARVING, WETTED, CellDeviations, Design, Inputs, Rows, solve_cell
from twin.tower.clean_cell import discrepancy
from twin.tower.effects import CellEffect, after_fill, before_fill

SLOW = ("fill", "air", "uniformity", "bias", "flow_meter")
"""Slow deviations; the last is a nuisance that is never reported: a drifting flow meter is seen in the pumps, not
here."""
DEVIATIONS = SLOW[:4]
INLET_C, WET_C, RANGE_K = 36.0, 25.0, 7.0
"""Design point where the datasheet gives none: that of the Cooling Technology Institute's usual rating, 95/85/78
degF."""
EXHAUST = 0.7
"""Rise of the air's temperature as a share of the way from its wet bulb to the hot water; an effectiveness of 0.6 to
0.8."""
FAN_DENSITY = "fan_density"
INDUCED, FORCED, ANY_DRAUGHT = (0.85, 0.1), (0.15, 0.1), (0.5, 0.35)
"""Mean and standard deviation of `fan_density` for a fan in the exhaust, one in the entering air, and either."""


@dataclass(frozen=True)
class Global:
    """A constant of a record with its prior."""

    name: str
    mean: float
    sd: float
    source: str


GLOBALS: tuple[Global, ...] = (
    Global("merkel", 0.0, 0.02, "logarithm; replaced by that of the commissioning"),
    Global("exponent", 0.0, 0.10, "replaced by that of the commissioning"),
    Global("inlet", -0.2, 0.2, "power of T_in in Me: Kloppers & Kroeger 2005 fit 0 to -0.5"),
    Global(
        "air_power",
        0.0,
        0.15,
        "power of the air in Me beyond that of the ratio: Kloppers & Kroeger 2005 fit both flows",
    ),
    Global(
        "fill_share",
        0.82,
        0.07,
        "share of the transfer in the fill itself, which scale acts on; up to 15 % is in the spray and 10 to 20 % in "
        "the rain zone, Kroeger 2004",
    ),
    Global(
        "wetting",
        1.0,
        0.25,
        "effect of a dry share over the law's, 0.5 to 1.3: overlapping sprays wet up to half of what blocked nozzles "
        "leave; dry fill draws up to 1.35 times the air, as half of the path's drop is the fill's and water at most "
        "doubles that, and a share then counts 1.35/(0.94 + 1.35 x 0.06)^2 times",
    ),
    Global("starving", 1.0, 0.7, "power by which nozzles starve as the flow falls: of their head, 0 to 2"),
    Global(
        "draft",
        0.16,
        0.06,
        "share of design air by buoyancy alone past a fan that turns, at 5 % of it: 5 to 20 % of counter-flow cells "
        "with the fan at rest, over `rest`",
    ),
    Global(
        "rest",
        0.75,
        0.15,
        "share of it that passes a fan at rest, 0.5 to 1: the fan's resistance is up to three times that of the cell",
    ),
    Global(
        "stalled",
        0.06,
        0.025,
        "share of design air that passes a fan at rest where wind stalls the draft: from what leaks, 0.02, to the "
        "draft of a calm, 0.1",
    ),
    Global(
        FAN_DENSITY,
        *INDUCED,
        "power of the exhaust's density over that of the entering air in the air flow: 1 for a fan in the exhaust, "
        "less what heavier air in the resistance before it gives back, up to 0.3: a flow goes with the power -0.2 to "
        "-0.35 of its resistance",
    ),
    Global(
        "wind_air", 0.0, 0.02, "change of the air flow for 5 m/s at full speed: 15 Pa of wind, 100 to 150 Pa of a fan"
    ),
    Global("inlet_bias", 0.0, 0.15, "K, class A thermometer in a thermowell"),
    Global("wet_bulb_bias", 0.0, 0.2, "K, aspirated psychrometer"),
    Global("recirculation", 0.02, 0.015, "share of the exhaust; CTI allows 0.3 to 0.6 K of induced-draft cells"),
    Global("recirculation_wind", 0.0, 0.015, "its change for 5 m/s"),
    Global("recirculation_north", 0.0, 0.015, "its change for 5 m/s from the north"),
    Global("recirculation_east", 0.0, 0.015, "its change for 5 m/s from the east"),
    Global("wet_bulb_1", 0.0, 0.3, "K for 15 K below design: Merkel's method against Poppe's, Kloppers & Kroeger 2005"),
    Global("wet_bulb_2", 0.0, 0.15, "K, square of it"),
    Global("range_1", 0.0, 0.15, "K for half the design range"),
    Global("speed_1", 0.0, 0.2, "K for half the speed"),
    Global("flow_1", 0.0, 0.2, "K for half the flow"),
    Global("wind_1", 0.0, 0.15, "K for 5 m/s"),
    Global("neighbours_1", 0.0, 0.1, "K for neighbours' fans at full speed over at rest"),
    Global(
        "kappa",
        KAPPA,
        1.7,
        "power of the air in the fan's power, negative: 0.4 by fouling of the path, -3 by a slipping belt; kept at its "
        "mean, its spread is that of a level (`twin.tower.cell_observations.fan_power`)",
    ),
    Global(
        "power_gain",
        0.0,
        0.25,
        "logarithm: pitch, belt and path move the level differently, so that only changes speak",
    ),
)
NAMES = tuple(one.name for one in GLOBALS)


@dataclass(frozen=True)
class DesignPoint:
    """Design point that the discrepancy is measured from: degC, K, kg/s."""

    inlet: float = INLET_C
    wet: float = WET_C
    fall: float = RANGE_K
    bypass_share: float = 0.0


@dataclass(frozen=True)
class Operation:
    """Operating points of a cell (n,): inputs, and the share of water past the fill, wind m/s, its direction from,
    neighbours' speed 0 to 1; `patterns` (n, k) are the drivers of the model's effects."""

    inputs: Inputs
    bypass: Array
    wind: Array
    wind_deg: Array
    neighbours: Array
    patterns: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def take(self, rows: Rows) -> Operation:
        """Return the operating points at these rows."""
        return Operation(
            self.inputs.take(rows),
            self.bypass[rows],
            self.wind[rows],
            self.wind_deg[rows],
            self.neighbours[rows],
            self.patterns[rows] if self.patterns.size else self.patterns,
        )


class CellModel:
    """Outlet thermometer and fan power of one cell as functions of slow deviations (n, 5) and constants.

    The constants are the global quantities (27,), or these and the weights of the discrepancy's features after them.
    """

    def __init__(self, design: Design, site: DesignPoint, effects: Sequence[CellEffect] = ()) -> None:
        self.design, self.site, self.effects = design, site, tuple(effects)
        self._lighter_at_design = exhaust_density_at(design, site.inlet, site.wet)

    def outlet(self, o: Operation, slow: Array, g: Array) -> Array:
        """Return the temperature of the water in the flume, degC, without the thermometer's bias (n,)."""
        q = dict(zip(NAMES, g, strict=False))
        o, slow = before_fill(self.effects, o, slow, lambda at, by: self._air_rise(at, by, q))
        points, deviations = self._at_fill(o, slow, q)
        out = solve_cell(points, self.design, deviations, with_evaporation=False).t_out
        out = out + self._discrepancy(o, q, points.t_in - out)
        if len(g) > len(NAMES):
            out = out + self.features(o) @ g[len(NAMES) :]
        return after_fill(self.effects, o, points.t_in, out + o.bypass * (points.t_in - out))

    def _at_fill(self, o: Operation, slow: Array, q: Mapping[str, float]) -> tuple[Inputs, CellDeviations]:
        """Return the inputs of the fill and its deviations, by the constants `q`."""
        u, d, site = o.inputs, self.design, self.site
        t_in = u.t_in + q["inlet_bias"]
        wet = u.wet + q["wet_bulb_bias"]
        m_w = u.m_w / np.exp(slow[:, 4])
        strong = o.wind / 5.0
        angle = np.radians(o.wind_deg)
        share = q["recirculation"] + strong * (
            q["recirculation_wind"] + q["recirculation_north"] * np.cos(angle) + q["recirculation_east"] * np.sin(angle)
        )
        inside = np.minimum(wet + share * EXHAUST * np.maximum(t_in - wet, 0.0), t_in)
        dry = np.maximum(u.dry, inside)
        lighter = exhaust_density(d, Inputs(t_in, m_w, u.speed, dry, inside, u.pressure), q["draft"])
        speed = effective_speed(u.speed, lighter, o.wind, q, self._lighter_at_design)
        speed = speed * (lighter / self._lighter_at_design) ** q["fan_density"]
        loading = m_w / d.m_w0 / speed
        rest = 1.0 - WETTED * (1.0 + max(q["wetting"], 0.0) * slow[:, 2])
        # The law's own power is STARVING; another one is another uniformity at this flow.
        uniformity = (1.0 - rest * (d.m_w0 / m_w) ** (q["starving"] - STARVING)) / WETTED
        law = (
            q["air_power"] * np.log(speed * (1.0 + slow[:, 1]))
            + q["merkel"]
            + q["inlet"] * np.log(np.maximum(t_in, 5.0) / site.inlet)
            - q["exponent"] * np.log(loading)
        )
        fill = (1.0 + q["fill_share"] * slow[:, 0]) * np.exp(law)
        points = Inputs(t_in, m_w, speed, dry, inside, u.pressure)
        return points, CellDeviations(fill, 1.0 + slow[:, 1], uniformity)

    def _air_rise(self, o: Operation, slow: Array, q: Mapping[str, float]) -> Array:
        """Return the rise of the air's enthalpy as a share of the way to saturated air at the hot water (n,).

        It hardly depends on the air that enters, so that of the ambient air serves.
        """
        points, deviations = self._at_fill(o, slow, q)
        found = solve_cell(points, self.design, deviations, with_evaporation=False)
        way = moist.saturated_enthalpy(points.t_in, points.pressure) - moist.saturated_enthalpy(
            points.wet, points.pressure
        )
        rise = found.heat / (found.m_a * np.maximum(way, LEAST_WAY))
        return np.asarray(np.clip(rise, 0.0, 1.0))

    def features(self, o: Operation) -> Array:
        """Return the features of the discrepancy at operating points (n, features)."""
        site, u = self.site, o.inputs
        points = discrepancy.coordinates(u.wet, u.t_in - u.wet, u.speed, u.m_w / self.design.m_w0, o.wind)
        one = np.ones(1)
        design = discrepancy.coordinates(site.wet * one, (site.inlet - site.wet) * one, one, one, CALM * one)
        return discrepancy.features(points, design)

    def reading(self, o: Operation, slow: Array, g: Array) -> Array:
        """Return the reading of the outlet thermometer, degC (n,)."""
        return self.outlet(o, slow, g) + slow[:, 3]

    def log_power(self, o: Operation, slow: Array, g: Array) -> Array:
        """Return the logarithm of the fan's power in kW (n,)."""
        q, u, d = dict(zip(NAMES, g, strict=False)), o.inputs, self.design
        ratio = np.maximum(moist.ratio_from_wet_bulb(u.dry, u.wet, u.pressure), 0.0)
        rho = moist.density(u.dry, ratio, u.pressure)
        rho = rho * (exhaust_density(d, u, q["draft"]) / self._lighter_at_design) ** q["fan_density"]
        shaft = (1.0 + slow[:, 1]) ** -q["kappa"] * np.maximum(u.speed, 0.02) ** d.speed_exponent * rho / d.density
        return np.asarray(np.log(max(d.power, 1e-9) * np.exp(q["power_gain"]) * shaft + d.idle))

    def _discrepancy(self, o: Operation, q: Mapping[str, float], fall: Array) -> Array:
        """Return the twin's own error at the operating points, K; none at design."""
        site, u = self.site, o.inputs
        cold = (site.wet - u.wet) / 15.0
        total = q["wet_bulb_1"] * cold + q["wet_bulb_2"] * cold**2
        total = total + q["range_1"] * 2.0 * (fall / site.fall - 1.0)
        total = total + q["speed_1"] * 2.0 * (1.0 - np.clip(u.speed, 0.0, 1.1))
        total = total + q["flow_1"] * 2.0 * (1.0 - u.m_w / self.design.m_w0)
        total = total + q["wind_1"] * (o.wind - CALM) / 5.0 + q["neighbours_1"] * (o.neighbours - 1.0)
        # Water that hardly cools cannot be off by more than it cools.
        return np.asarray(np.clip(total, -1.5, 1.5) * np.clip(fall / (0.3 * site.fall), 0.0, 1.0))
