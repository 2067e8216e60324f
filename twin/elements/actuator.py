"""Actuator, or the meter of a command: elements see its output instead of its input column.

    c(t)  = command(t - dead_time_s)
    lag_s * da/dt = c - a
    d = full * (a / full)^exponent
    value = gain * d * (1 - droop * a / full) + offset, changed as a `law_actuator` or `law_input` may name

An actuator or meter of anything but a temperature delivers nothing where that is less than nothing: `offset` below zero
is a dead band.

The value is the mean over each sample interval, so that it is continuous in dead time and lag and no energy is
lost between the samples. With gain = exponent = 1 and everything else 0 it is the column itself.

Source: first-order lag with dead time (Astrom & Hagglund, Advanced PID Control, 2006, sec. 2.5); `droop` is the share
that is missing at full command, as in a supply that sags or a pump that works against its own friction. `exponent`
describes a measured curve, such as that of a lamp's power over its voltage or of an installed valve.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from twin.elements.base import STAMP, Element, Names, ParameterSpec, place
from twin.elements.candidates import Candidate, Sites, input_target
from twin.elements.fragments import Export, Fragment, InputDrive
from twin.elements.meter import unit_of

LUMPED_S = 25.0
"""Lag that an element's heat capacity and the transport of water give to an immediate step, s."""

LEAST_SHARE = 1.0e-9
"""Least share of the full command in a power law, whose logarithm is finite."""


@dataclass(frozen=True)
class Actuator(Element):
    """Gain, droop, dead time and lag of one input column."""

    kind: ClassVar[str] = "actuator"
    parameters: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("gain", "1", 1.0, 0.0, 8.0, "fixed", "output over command"),
        ParameterSpec("droop", "1", 0.0, -0.5, 0.9, "fixed", "share missing at full command"),
        ParameterSpec("exponent", "1", 1.0, 0.2, 5.0, "fixed", "power of the command that the output follows"),
        ParameterSpec("dead_time_s", "s", 0.0, 0.0, 3600.0, "fixed", "time before a command shows"),
        ParameterSpec("lag_s", "s", 0.0, 0.0, 3600.0, "fixed", "time constant of the output"),
    )

    column: str = place("input", "input column with the command")

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        suffix = self.column.rsplit("_", 1)[-1]
        unit = {"pct": "%", "C": "degC"}.get(suffix, suffix)
        full = _full(self.column)
        offset = ParameterSpec("offset", unit, 0.0, -1.0e3, 1.0e3, "fixed", "0 for a command or meter in calibration")
        return (*self.parameters, ParameterSpec("full", unit, full, 1.0e-3, 1.0e6, "fixed", "full command"), offset)

    @classmethod
    def missing_candidates(cls, sites: Sites) -> tuple[Candidate, ...]:
        having = {e.column for e in sites.having(cls.kind)}
        found: list[Candidate] = []
        for column in sites.inputs:
            if column not in having and column not in (sites.clock, STAMP):
                name = f"actuator_of_{column}"
                table = {name: {"kind": cls.kind, "column": column}}
                full = sites.scales.get(column, 0.0) or _full(column)
                found += _with_forms([replace(c, adds=table) for c in _faults(column, name, _NEUTRAL, full)])
        return tuple(found)

    def changed_candidates(self, sites: Sites) -> tuple[Candidate, ...]:
        now = {key: sites.values[f"{self.name}.{key}"] for key in _NEUTRAL}
        changed = {f"{self.name}.{key}" for key, value in now.items() if value != _NEUTRAL[key]}
        faults = _faults(self.column, self.name, now, sites.values[f"{self.name}.full"])
        return tuple(_with_forms([replace(c, change="existing") if changed & set(c.changes) else c for c in faults]))

    def emit(self, n: Names) -> Fragment:
        value = n.arrived()
        if n.constant("exponent") != 1.0:
            full = n.par("full")
            value = f"{full} * exp({n.par('exponent')} * log(max({value} / {full}, {LEAST_SHARE})))"
        if n.constant("gain") != 1.0:
            value = f"{n.par('gain')} * {value}"
        if n.constant("droop") != 0.0:
            value += f" * (1.0 - {n.par('droop')} * {n.arrived()} / {n.par('full')})"
        if n.constant("offset") != 0.0:
            value += f" + {n.par('offset')}"
            if not self.column.endswith("_C"):
                value = f"max({value}, 0.0)"
        changes = n.changed_by(input_target(self.column))
        for change in changes:
            value = change.format(output=f"({value})", command=n.arrived())
        dead_time = None if n.constant("dead_time_s") == 0.0 else n.par("dead_time_s")
        lag = None if n.constant("lag_s") == 0.0 else n.par("lag_s")
        unit = unit_of(self.column)
        exports = {"delivered": Export(unit, n.input(self.column))} if unit else {}
        if value == n.arrived() and dead_time is None and lag is None:
            return Fragment(exports=exports)
        drive = InputDrive(self.column, value, dead_time, lag, varies=bool(changes))
        return Fragment(drive=drive, exports=exports)


_NEUTRAL = {"gain": 1.0, "exponent": 1.0, "droop": 0.0, "dead_time_s": 0.0, "lag_s": 0.0, "offset": 0.0}


def _full(column: str) -> float:
    return 1000.0 if column.endswith("_W") else 100.0


def _with_forms(faults: list[Candidate]) -> list[Candidate]:
    """Return the faults of an actuator, with the dead time as another form of the lag, which it resembles."""
    if len(faults) < 2:
        return faults
    *others, lag, dead_time = faults
    return [*others, replace(lag, near=partial(tuple, (dead_time,)))]


def _faults(column: str, name: str, now: Mapping[str, float], full: float) -> list[Candidate]:
    """Return the possible faults of an actuator, or of a temperature's meter, that has these values now; `full` is its
    full command."""
    what, unit = column.rsplit("_", 1)
    if unit == "C":
        return [
            Candidate(
                "sensor",
                column,
                "constant",
                "new",
                {f"{name}.offset": -1.0},
                "K",
                0.5,
                -20.0,
                20.0,
                "reads {value} too high",
            ),
        ]
    gain, droop = now["gain"], now["droop"]
    return [
        Candidate(
            "actuator",
            what,
            "constant",
            "new",
            {f"{name}.gain": 1.0},
            "1",
            0.03,
            -gain,
            3.0 - gain,
            # The share is of the command, not of what it delivered before.
            "delivers {share} more than its command"
            if gain == 1.0
            else f"delivers {{share}} more of its command than the {100.0 * gain:.3g} % that the twin has",
            total_loss=-gain if unit == "pct" else 0.0,
        ),
        Candidate(
            "actuator",
            what,
            what,
            "new",
            {f"{name}.droop": 1.0},
            "1",
            0.05,
            -0.4 - droop,
            0.8 - droop,
            "falls short by {share} at full command",
        ),
        # Fans start at 10 to 20 % of their command, pumps that lift water at 20 to 30 %.
        Candidate(
            "actuator",
            what,
            what,
            "new",
            {f"{name}.offset": -1.0},
            "%" if unit == "pct" else unit,
            0.1 * full,
            min(now["offset"], 0.0),
            0.5 * full + now["offset"],
            "delivers nothing up to a command of {value}, and as much less above it",
            shapes=("step",),
        ),
        # Bounded at zero: an actuator that would act before its command is not late, and the hypothesis is refused.
        *(
            Candidate(
                "actuator",
                what,
                "history",
                "new",
                {f"{name}.{parameter}": 1.0},
                "s",
                60.0,
                0.0,
                3600.0,
                says,
                shapes=("step",),
                lumped=LUMPED_S,
            )
            for parameter, says in (
                ("lag_s", "follows its command late by {value}"),
                ("dead_time_s", "answers its command only after {value}"),
            )
        ),
    ]
