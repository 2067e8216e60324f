"""Thermometer, or several whose mean is read as one.

    seen    = (1 - cross_talk) * T(node) + cross_talk * T(other)
    lag_s * dz/dt = seen - z
    reading = gain * z + bias_K + drift_K_per_h * t / 3600 + change + noise

with t the time stamp in s. A `law_reading` may name a change. `other` is a node whose temperature the thermometer picks
up (through its sheath, or a common reference junction); without it there is no cross-talk. The noise of a mean of k
thermometers is sigma / sqrt(k). Missing columns of a list are left out of the mean; a sample with none left is masked.

Source: first-order thermometer (Doebelin, Measurement Systems, 5th ed., sec. 3.3); gain, bias and drift as in the
Guide to the Expression of Uncertainty in Measurement, JCGM 100:2008, annex H.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from twin.elements.base import Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, EffectSize, Sites
from twin.elements.fragments import Fragment, SensorLag

LUMPED_S, PIPED_S = 25.0, 6.0
"""Time that water needs through a small loop's hoses and cold plates, s; a twin without pipes sees it as a sensor lag.
The second is the time that remains with pipes, from mixing in them.
"""
ADJUSTED_C = 25.0
"""Temperature of a room in which thermometers are adjusted, degC."""
LEAST_ADJUSTED_C, MOST_ADJUSTED_C = 0.0, 100.0
"""Ice point and boiling point, between which baths for thermometers are; at the former a gain is a factor."""
ADJUSTED_APART_K = (10.0, 5.0, 2.5, 1.25, 0.6, 0.3)
"""Distances, K, at which other temperatures of adjustment are tried around the best so far. An error of 10 % about one
that is wrong by half of the least leaves 0.015 K, less than the noise of most thermometers."""
LAGS_S = (15.0, 60.0, 240.0)
"""Lags around which an unknown one is sought, s: a late reading is not proportional to its lag."""


@dataclass(frozen=True)
class Sensor(Element):
    """Sensor at a node; the element's name is the name of the sensor in every table."""

    kind: ClassVar[str] = "sensor"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("sigma", "K", 0.05, 1.0e-4, 10.0, "fixed", "standard deviation of one thermometer"),
        ParameterSpec("lag_s", "s", 0.0, 0.0, 3600.0, "fixed", "time constant of the thermometer"),
        ParameterSpec("bias_K", "K", 0.0, -20.0, 20.0, "fixed", "offset; 0 for a thermometer in calibration"),
        ParameterSpec("drift_K_per_h", "K/h", 0.0, -1.0, 1.0, "fixed", "0 for a thermometer in calibration"),
        ParameterSpec("gain", "1", 1.0, 0.5, 1.5, "fixed", "1 for a thermometer in calibration"),
    )

    node: str = place("node", "node whose temperature is read")
    measured: tuple[str, ...] = place("columns", "measured columns that are averaged", key="columns")
    other: str = place("node", "node whose temperature is picked up as well", default="")

    def nodes(self) -> tuple[str, ...]:
        return (self.node, self.other) if self.other else (self.node,)

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        if not self.other:
            return self.parameters
        spec = ParameterSpec("cross_talk", "1", 0.0, 0.0, 1.0, "fixed", "share of the other node in the reading")
        return (*self.parameters, spec)

    def problem(self, values: Mapping[str, float]) -> str | None:
        bad = [column for column in self.measured if not column.endswith("_C")]
        if bad:
            return f"column {bad[0]!r} is not a temperature in degC: its name does not end in _C"
        if self.other == self.node:
            return "the other node is the node itself"
        return None

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        where = self.measured[0] if len(self.measured) == 1 else self.name
        sensor, now = ("sensor", where), {k: sites.values[f"{self.name}.{k}"] for k in ("gain", "lag_s")}
        # A delay, bounded at zero: a fit that asks for less of one refuses the hypothesis.
        later = [
            replace(
                self.parameter_candidate(
                    "lag_s", *sensor, "rate_of_change", EffectSize("s", lag, 0.0, 3600.0), "reads late by {value}"
                ),
                change="new" if now["lag_s"] == 0.0 else "existing",
                shapes=("step",),
                lumped=PIPED_S if sites.having("pipe") else LUMPED_S,
            )
            for lag in LAGS_S
        ]
        found = [
            replace(
                self.parameter_candidate(
                    "bias_K", *sensor, "constant", EffectSize("K", 0.2, -20.0, 20.0), "reads {value} too high"
                ),
                change="new",
            ),
            replace(
                self.parameter_candidate(
                    "gain",
                    *sensor,
                    "temperature",
                    EffectSize("1", 0.01, 0.5 - now["gain"], 1.5 - now["gain"]),
                    "reads by a factor that is {share} too high",
                ),
                change="new",
            ),
            *later,
        ]
        gain = next(c for c in found if f"{self.name}.gain" in c.changes)
        found.insert(2, self._gain_about(gain, ADJUSTED_C))
        if f"{self.name}_sticks.size" in sites.values:
            found.append(self._stuck_otherwise(where, sites.values))
        else:
            found.append(self._stuck(where, ADJUSTED_C))
        if self.other:
            now_c = sites.values[f"{self.name}.cross_talk"]
            says = f"picks up another share of the temperature of {self.other}: a change by {{value}}"
            share = self.parameter_candidate(
                "cross_talk", *sensor, "temperature_difference", EffectSize("1", 0.02, -now_c, 1.0 - now_c), says
            )
            return (*found, share)
        for other in sites.nodes:
            if other != self.node:
                says = f"picks up {{value}} of the temperature of {other}"
                found.append(
                    Candidate(
                        *sensor,
                        "temperature_difference",
                        "new",
                        {f"{self.name}.cross_talk": 1.0},
                        "1",
                        0.02,
                        0.0,
                        1.0,
                        says,
                        replaces={self.name: {"other": other}},
                    )
                )
        return tuple(found)

    def _gain_about(self, gain: Candidate, about_c: float) -> Candidate:
        """Return an error of gain of a thermometer that is right at `about_c`, degC, where it was adjusted.

        That is the ice point, the room, or any bath. Others are tried where one scores, since a wrong one makes the
        gain wrong.
        """

        def near() -> tuple[Candidate, ...]:
            others = [about_c + side * apart for apart in ADJUSTED_APART_K for side in (-1.0, 1.0)]
            return tuple(self._gain_about(gain, c) for c in others if LEAST_ADJUSTED_C < c <= MOST_ADJUSTED_C)

        return replace(
            gain,
            changes={f"{self.name}.gain": 1.0, f"{self.name}.bias_K": -about_c},
            says=f"reads {{share}} too high of what is above {about_c:g} degC",
            near=near,
        )

    def _stuck(self, where: str, level_c: float) -> Candidate:
        """Return a thermometer that sticks at a level, degC; the one of the catalogue stands for all levels."""
        return Candidate(
            "sensor",
            where,
            "temperature",
            "new",
            {f"{self.name}_follows.gain": -1.0, f"{self.name}_sticks.size": level_c},
            "1",
            0.2,
            0.0,
            1.0,
            f"sticks at {level_c:.1f} degC: it misses {{share}} of every change",
            adds={
                f"{self.name}_follows": {
                    "kind": "law_reading",
                    "sensor": self.name,
                    "of": self.node,
                    "form": "linear",
                    "reference": 0.0,
                },
                f"{self.name}_sticks": {"kind": "law_reading", "sensor": self.name, "form": "constant"},
            },
            at_level=lambda shown_c: self._stuck(where, shown_c),
            level=level_c,
        )

    def _stuck_otherwise(self, where: str, values: Mapping[str, float]) -> Candidate:
        """Return another share of every change that a thermometer misses which sticks already."""
        share = -values[f"{self.name}_follows.gain"]
        level_c = values[f"{self.name}_sticks.size"] / share if share else 0.0
        says = f"sticks at {level_c:.1f} degC: it misses {{share}} more of every change than before"
        return replace(
            self._stuck(where, level_c),
            change="existing",
            says=says,
            lower=-share,
            upper=1.0 - share,
            adds={},
            at_level=None,
        )

    def emit(self, n: Names) -> Fragment:
        reading = n.temperature(self.node)
        if self.other and n.constant("cross_talk") != 0.0:
            share = n.par("cross_talk")
            reading = f"((1.0 - {share}) * {reading} + {share} * {n.temperature(self.other)})"
        lags: tuple[SensorLag, ...] = ()
        if n.constant("lag_s") != 0.0:
            lags = (SensorLag("z", of=reading, constant=n.par("lag_s")),)
            reading = n.lagged("z")
        if n.constant("gain") != 1.0:
            reading = f"{n.par('gain')} * {reading}"
        if n.constant("bias_K") != 0.0:
            reading += f" + {n.par('bias_K')}"
        if n.constant("drift_K_per_h") != 0.0:
            reading += f" + {n.par('drift_K_per_h')} * {n.time()} * {1.0 / 3600.0!r}"
        for change in n.changed_by():
            reading += f" + {change}"
        return Fragment(observe=reading, lags=lags)
