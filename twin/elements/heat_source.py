"""Heat released in a node, constant or following an input column.

    no driver      Q = power
    proportional   Q = factor * column                             the column is a power
    linear         Q = gain * (column - reference)                 any column
    squared, cubed Q = power_100 * (column / 100)^2, ^3            the column is a speed
    daily          Q = c cos(2 pi h / 24) + s sin(2 pi h / 24)     the column is a clock
    daylight       c cos(2 pi h / 24) + s sin(2 pi h / 24) - n, 0 where that would be negative

Sources: Q_j of eq. 1 of Energies 2026, 19, 2452: the heater's is its measured electrical power times the "effective
heat input" of Table 2, the modules' the constant Q_pm of Table 1, zero in a healthy loop. Cubed: a pump's shaft
power by the affinity laws (Karassik et al., Pump Handbook, 4th ed., sec. 2.3), which ends as heat in the water;
squared: heat in proportion to its head.
Daily: first harmonic of a day, of amplitude sqrt(c^2 + s^2) with its peak at 24/(2 pi) atan2(s, c) o'clock;
`daylight` is the sun on a surface, without an effect at night: it lasts 24/pi acos(n / sqrt(c^2 + s^2)) h.

A clock is an input column like any other: hours since midnight, named with the ending `_h`, e.g. `time_of_day_h`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import INTERMITTENT, Candidate, EffectSize, Sites
from twin.elements.fragments import Export, Fragment

LAWS = ("proportional", "linear", "squared", "cubed", "daily", "daylight")
POWERS = ("squared", "cubed")
CLOSER = (
    ((-1.0, -0.5, 0.0, 0.5, 1.0), (-4.0, -2.0, 0.0, 2.0)),
    ((-0.25, 0.0, 0.25), (-1.0, 0.0, 1.0)),
    ((-0.1, 0.0, 0.1), (-0.5, 0.0, 0.5)),
)
"""Hours by which the peak, and the length of the day, of a source that follows the hour are varied, ever more
closely.
"""
SHORTEST_H, LONGEST_H = 3.0, 20.0
"""Shortest and longest length of day that is tried, h."""
CUBED = "with its cube"
_UNITS = {
    "pct": "%",
    "C": "K",
    "m3_h": "(m3/h)",
    "kg_s": "(kg/s)",
    "L_min": "(L/min)",
    "W_m2": "(W/m2)",
    "m_s": "(m/s)",
}
_OTHER_LAWS = ("_C", "_pct", "_h")
"""Endings of inputs that nothing uses and that have laws of their own, or no heat: temperatures, speeds, a clock."""
MOST_EVENT_W = 1.0e5
"""Heat that comes in for a time at most, W: as much as the element allows."""
TYPICAL_W, MUCH = 20.0, 1.0e4
"""Heat of interest that an input may bring in over its range, W, and the largest, in multiples of it."""


@dataclass(frozen=True)
class HeatSource(Element):
    """A heat input, constant unless a driver column is named."""

    kind: ClassVar[str] = "heat_source"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("power", "W", 0.0, -1.0e5, 1.0e5, "tunable", "constant heat input; zero in a healthy loop"),
    )

    node: str = place("node", "node that receives the heat")
    driver: str = place("input", "input column that the heat follows, left out for a constant source", default="")
    law: str = place("choice", "how the heat follows the driver", choices=LAWS, default="proportional")

    def inputs(self) -> tuple[str, ...]:
        return (self.driver,) if self.driver else ()

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        if not self.driver:
            return self.parameters
        if self.law in POWERS:
            return (ParameterSpec("power_100", "W", 0.0, -1.0e4, 1.0e4, "tunable", "heat at 100 % speed"),)
        if self.law in ("daily", "daylight"):
            source = "component of the daily swing; both 0 without a daily swing"
            swing = (
                ParameterSpec("cosine", "W", 0.0, -1.0e4, 1.0e4, "tunable", f"midnight {source}"),
                ParameterSpec("sine", "W", 0.0, -1.0e4, 1.0e4, "tunable", f"six o'clock {source}"),
            )
            night = ParameterSpec("night", "W", 0.0, -1.0e4, 1.0e4, "fixed", "0 for a day of twelve hours")
            return swing if self.law == "daily" else (*swing, night)
        if self.law == "proportional":
            return (ParameterSpec("factor", "1", 1.0, 0.0, 8.0, "tunable", "heat that arrives over power measured"),)
        unit = self.unit()
        return (
            ParameterSpec("gain", f"W/{unit}", 0.0, -1.0e4, 1.0e4, "tunable", "heat for one unit of the driver"),
            ParameterSpec("reference", unit.strip("()"), 0.0, -1.0e4, 1.0e4, "fixed", "driver at which it is zero"),
        )

    def unit(self) -> str:
        """Return the unit of the driver by its name's suffix, K for a temperature."""
        return self.named()[1]

    def named(self) -> tuple[str, str]:
        """Return the driver's name without its unit, and the unit."""
        known = [(suffix, unit) for suffix, unit in _UNITS.items() if self.driver.endswith(f"_{suffix}")]
        suffix, unit = known[0] if known else (self.driver.rsplit("_", 1)[-1],) * 2
        return self.driver.removesuffix(f"_{suffix}"), unit

    def problem(self, values: Mapping[str, float]) -> str | None:
        if not self.driver:
            return None if self.law == "proportional" else f"the law {self.law!r} needs a driver"
        if self.law == "proportional" and not self.driver.endswith("_W"):
            return f"driver {self.driver!r} is not a power: its name does not end in _W; the law 'linear' takes others"
        if self.law in POWERS and not self.driver.endswith("_pct"):
            return f"driver {self.driver!r} is not a speed in %: its name does not end in _pct"
        if self.law in ("daily", "daylight") and not self.driver.endswith("_h"):
            return f"driver {self.driver!r} is not a time of day in hours: its name does not end in _h"
        if "_" not in self.driver:
            return f"driver {self.driver!r} has no unit in its name; end it with one, for example _W, _pct or _C"
        return None

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        found: list[Candidate] = []
        known = {e.node for e in sites.having(cls.kind) if not e.driver}
        stands = [(sites.places[node], (node,)) for node in sites.nodes] + list(sites.groups.items())
        others = _unused_inputs(sites)
        for where, nodes in stands:
            for driver, table, sizes, unit, typical, says in _laws(sites):
                if driver == "constant" and set(nodes) <= known:
                    continue
                if any(e.driver == table.get("driver") for e in sites.having(cls.kind) if e.node in nodes):
                    continue
                words = "_".join((driver, nodes[0] if len(nodes) == 1 else where))
                names = {node: f"heat_by_{words}" if len(nodes) == 1 else f"heat_by_{words}_{node}" for node in nodes}
                share = 1.0 / len(nodes)
                changes = {
                    f"{name}.{size}": weight * share for name in names.values() for size, weight in sizes.items()
                }
                adds = {name: {"kind": cls.kind, "node": node, **table} for node, name in names.items()}
                source = Candidate(
                    "heat_source",
                    where,
                    driver,
                    "new",
                    changes,
                    unit,
                    typical,
                    0.0,
                    2000.0 * typical / 20.0,
                    says,
                    adds=adds,
                )
                if table.get("driver") in others:
                    # The share of it that a rig may catch is unknown.
                    source = replace(source, upper=MUCH * typical)
                if table.get("law") == "cubed":
                    source = replace(source, near=partial(_other_powers, source))
                if table.get("law") == "daylight":
                    peak_h = 12.0 / math.pi * math.atan2(sizes["sine"], sizes["cosine"])
                    # A day that itself grows would imitate any other growing effect.
                    source = replace(source, shapes=("step",))
                    source = replace(source, near=partial(_other_days, source, peak_h, 12.0, share))
                found += [source, _passing(source)] if driver == "constant" and len(nodes) == 1 else [source]
        return tuple(found)

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where = sites.places[self.node]
        if not self.driver:
            now = sites.values[f"{self.name}.power"]
            says = "gives off {value} more than the twin has there" if now else _UNKNOWN
            power = self.parameter_candidate(
                "power", "heat_source", where, "constant", EffectSize("W", 20.0, -now if now else 0.0, 2000.0), says
            )
            power = power if now else replace(power, change="new")
            return power, _passing(power)
        if self.law == "proportional":
            now, where = sites.values[f"{self.name}.factor"], self.driver.rsplit("_", 1)[0]
            says = "gives {value} more heat than its reading says"
            return (
                self.parameter_candidate(
                    "factor", "actuator", where, "constant", EffectSize("W/W", 0.03, -now, 3.0), says
                ),
            )
        if self.law in ("daily", "daylight"):
            return self._other_day(where, sites)
        column, unit = self.driver.rsplit("_", 1)
        if self.law == "linear" and unit == "W":
            now, says = sites.values[f"{self.name}.gain"], f"takes up {{value}} more of {column} than when commissioned"
            return (
                self.parameter_candidate(
                    "gain", "heat_source", where, column, EffectSize("W/W", 0.03, -now, 3.0), says
                ),
            )
        if unit != "pct":
            return ()
        size, full = ("power_100", 1.0) if self.law in POWERS else ("gain", 100.0)
        now = full * sites.values[f"{self.name}.{size}"]
        says = f"gives off {{value}} more at full {column.replace('_', ' ')} than when commissioned"
        power = self.parameter_candidate(size, "heat_source", where, column, EffectSize("W", 20.0, -now, 2000.0), says)
        return (replace(power, changes={name: w / full for name, w in power.changes.items()}),)

    def _other_day(self, where: str, sites: Sites) -> tuple[Candidate, ...]:
        """Return the candidate of the same hours with another peak."""
        now = {s.name: sites.values[f"{self.name}.{s.name}"] for s in self.parameter_specs()}
        peak = math.hypot(now["cosine"], now["sine"]) - now.get("night", 0.0)
        if peak <= 0.0:
            return ()
        changes = {f"{self.name}.{size}": value / peak for size, value in now.items() if value}
        says = "gives off up to {value} more in the course of the day than when commissioned"
        return (
            Candidate(
                "heat_source",
                where,
                "time_of_day",
                "existing",
                changes,
                "W",
                20.0,
                -peak,
                2000.0,
                says,
                shapes=("step",),
            ),
        )

    def emit(self, n: Names) -> Fragment:
        found = self._heat(n)
        return replace(found, exports={"heat": Export("W", found.heat[self.node])})

    def _heat(self, n: Names) -> Fragment:
        """Return the formulas of the law."""
        if not self.driver:
            return Fragment(heat={self.node: n.par("power")})
        column = n.input(self.driver)
        if self.law in POWERS:
            share, power = n.local("share"), n.local("cube" if self.law == "cubed" else "square")
            product = " * ".join([share] * (3 if self.law == "cubed" else 2))
            uniform = ((share, f"max({column}, 0.0) * 0.01"), (power, product))
            return Fragment(uniform=uniform, heat={self.node: f"{n.par('power_100')} * {power}"})
        if self.law in ("daily", "daylight"):
            turn, square, cosine, sine = (n.local(name) for name in ("turn", "square", "cosine", "sine"))
            heat = f"{n.par('cosine')} * {cosine} + {n.par('sine')} * {sine}"
            return Fragment(
                uniform=(
                    (turn, f"{math.pi!r} * (({column}) % 24.0 / 12.0 - 1.0)"),
                    (square, f"{turn} * {turn}"),
                    (cosine, f"-({_series(square, 0)})"),
                    (sine, f"-{turn} * ({_series(square, 1)})"),
                ),
                heat={self.node: f"max({heat} - {n.par('night')}, 0.0)" if self.law == "daylight" else heat},
            )
        if self.law == "proportional":
            return Fragment(heat={self.node: f"{n.par('factor')} * {column}"})
        return Fragment(heat={self.node: f"{n.par('gain')} * ({column} - {n.par('reference')})"})


def _passing(constant: Candidate) -> Candidate:
    """Return the candidate of heat that comes in for a time, which may bring in a minute what is usual in an hour."""
    return replace(constant, typical=60.0 * constant.typical, lower=0.0, upper=MOST_EVENT_W, shapes=INTERMITTENT)


_UNKNOWN = "gives off {value} that the twin does not know of"


def _laws(sites: Sites) -> list[tuple[str, dict[str, str], dict[str, float], str, float, str]]:
    """Return sources that may be missing, a tuple each.

    Driver, keys of the table, size parameters with weights, unit of the size, a typical size, wording.
    """
    laws: list[tuple[str, dict[str, str], dict[str, float], str, float, str]] = [
        ("constant", {}, {"power": 1.0}, "W", 20.0, _UNKNOWN)
    ]
    sources = sites.having(HeatSource.kind)
    # A speed moves air or water, in addition to its heat.
    speeds = {column for e in sites.elements if e.kind != HeatSource.kind for column in e.inputs()}
    heaters = {e.driver for e in sources if e.law == "linear" and e.driver.endswith("_pct")} - speeds
    others = _unused_inputs(sites)
    for column in sites.inputs:
        straight = {"driver": column, "law": "linear"}
        if column in others:
            laws.append(_of_unused_input(column, sites.scales.get(column, 1.0)))
        elif column.endswith("_W"):
            laws.append(
                ("heater_power", straight, {"gain": 1.0}, "W/W", 0.03, "takes up {value} of the heater's power")
            )
        if column in heaters:
            driver = column.removesuffix("_pct")
            says = f"takes up {{value}} of {driver.replace('_', ' ')}, which heats elsewhere"
            laws.append((driver, straight, {"gain": 1.0}, "W/%", 0.01, says))
        elif column.endswith("_pct"):
            driver = column.removesuffix("_pct")
            says = f"gives off {{value}} at full {driver.replace('_', ' ')}"
            cubed = {"driver": column, "law": "cubed"}
            laws.append((driver, cubed, {"power_100": 1.0}, "W", 20.0, f"{says}, {CUBED}"))
    if sites.clock:
        for peak in range(0, 24, 2):
            table = {"driver": sites.clock, "law": "daylight"}
            laws.append(("time_of_day", table, daylight_parameters(peak, 12.0), "W", 20.0, _daylight_text(peak)))
    return laws


def _unused_inputs(sites: Sites) -> set[str]:
    """Return inputs that no element of the twin uses and for which there is no other law."""
    used = {column for e in sites.elements for column in e.inputs()}
    return {c for c in sites.inputs if c not in used and "_" in c and not c.endswith(_OTHER_LAWS)}


def _of_unused_input(column: str, scale: float) -> tuple[str, dict[str, str], dict[str, float], str, float, str]:
    """Return a source in proportion to an input that no element of the twin uses: sun, wind, another machine."""
    driver, unit = HeatSource("", "", column, "linear").named()
    says = f"takes up {{value}} of {driver.replace('_', ' ')}"
    size = f"W/{unit}"
    return driver, {"driver": column, "law": "linear"}, {"gain": 1.0}, size, TYPICAL_W / max(scale, 1e-9), says


def _other_powers(cubed: Candidate) -> tuple[Candidate, ...]:
    """Return a source that follows a speed with its cube as one with its square, and as one in proportion to it.

    The heat of a fan's pressure or of a belt does not follow the cubic law of a shaft.
    """

    def other(suffix: str, law: str, size: str, full: float, words: str) -> Candidate:
        changes = {name.replace(".power_100", f"_{suffix}.{size}"): w / full for name, w in cubed.changes.items()}
        adds = {f"{name}_{suffix}": {**table, "law": law} for name, table in cubed.adds.items()}
        return replace(cubed, changes=changes, adds=adds, says=cubed.says.replace(CUBED, words), near=None)

    return (
        other("straight", "linear", "gain", 100.0, "in proportion to it"),
        other("squared", "squared", "power_100", 1.0, "with its square"),
    )


def daylight_parameters(peak_h: float, hours: float) -> dict[str, float]:
    """Return the parameters of a day of so many hours, 1 W at its peak."""
    turn, edge = math.pi * peak_h / 12.0, math.cos(math.pi * hours / 24.0) if hours != 12.0 else 0.0
    return {n: v / (1.0 - edge) for n, v in (("cosine", math.cos(turn)), ("sine", math.sin(turn)), ("night", edge))}


def _daylight_text(peak_h: float) -> str:
    return f"gives off up to {{value}} in the course of the day, most at about {peak_h:g} h"


def _other_days(source: Candidate, peak_h: float, hours: float, share: float, level: int = 0) -> tuple[Candidate, ...]:
    """Return sources by daylight with other peaks, and longer or shorter days, each with closer ones around it.

    The shortest and the longest of the first ones have others as far away around them, because the best may lie beyond.
    `peak_h` and `hours` describe the present day; `share` is that of the heat in each of its nodes.
    """
    found = []
    shifts, lengths = CLOSER[level]
    for shift, longer in itertools.product(shifts, lengths):
        other_h, length = (peak_h + shift) % 24.0, hours + longer
        if not SHORTEST_H <= length <= LONGEST_H:
            continue
        weights = daylight_parameters(other_h, length)
        changes = {name: weights[name.rsplit(".", 1)[1]] * share for name in source.changes}
        after = 0 if level == 0 and longer in (lengths[0], lengths[-1]) else level + 1
        near = partial(_other_days, source, other_h, length, share, after) if after < len(CLOSER) else None
        found.append(replace(source, changes=changes, says=_daylight_text(round(other_h, 1)), near=near))
    return tuple(found)


def _series(square: str, odd: int) -> str:
    """Return the Taylor series of cos x (odd = 0) or sin x / x (odd = 1) in x^2, right to 1e-9 for |x| up to pi."""
    text = "0.0"
    for k in range(11, -1, -1):
        text = f"{(-1.0) ** k / math.factorial(2 * k + odd)!r} + {square} * ({text})"
    return text
