"""General laws: an effect at a site that follows any driver by any form and time course.

A law is an effect without a named cause: a site, a driver x, a form and a time course, with the vocabulary of
`law_forms`. Each site is a kind of its own, in a file of its name. x is an input column or a temperature, less another
temperature where one is named.

    law_heat         value W into a node; with `source`, taken out of that node
    law_fluid        value kg/s of a fluid into a node whose volume overflows: cp value (temperature - T)
    law_conductance  value W/K between a node and another, or an input column: value (T_other - T)
    law_flow         flow times (1 + value), or plus value L/min
    law_reading      reading plus value K
    law_actuator     output of an actuator times (1 + value)
    law_input        temperature of an input column less value K, by which its thermometer reads too high

The value of a law with an input column as driver, and that of a threshold, is computed once a sample. A switch looks
at its driver at the samples, and a memory follows the column as it is held between them, exactly. A flow follows a
temperature as it was at the sample. A law that follows a temperature is limited, so that heat cannot grow without
bound: `LIMITS`.

Source: heat balances of the lumped volume, Incropera, Fundamentals of Heat and Mass Transfer, 7th ed., ch. 5.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.column_names import UNITS_OF_SUFFIX
from twin.elements.base import STAMP, Element, Names, ParameterSpec, place
from twin.elements.candidates import input_target
from twin.elements.fragments import ElementState, Fragment, SampleMemory
from twin.elements.law_forms import (
    COURSES,
    FORMS,
    course_specs,
    course_text,
    follow_text,
    form_specs,
    form_text,
    slope_text,
    switch_text,
)

LIMITS = {"W": 1.0e5, "kg/s": 10.0, "W/K": 1.0e4, "K": 1.0e3, "1": 1.0e3, "L/min": 1.0e4}
"""Largest value of a law that follows a temperature, by its unit; for heat also that of a conductance law."""
STEEPEST = 1.0e5
"""Largest slope for which the kernel shortens its steps, W/K; a steeper law only switches between its limits."""
MOST_SHARE = 9.0
"""Largest relative increase of a flow or of an actuator's output."""
REMEMBERING = ("memory", "rate")
"""Forms that depend on the past of their driver."""


@dataclass(frozen=True, kw_only=True)
class Law(Element):
    """A site's share of what all laws have in common: driver, form, time course."""

    unit: ClassVar[str]
    """Unit of the value."""
    most: ClassVar[float]
    """Largest strength."""
    total: ClassVar[tuple[str, float]] = ("", 0.0)
    """Unit and bound of a pulse's amount, where it is the natural strength."""

    driver: str = place("input", "input column that the law follows", default="")
    of: str = place("node", "node whose temperature it follows instead", default="")
    minus: str = place("node", "node whose temperature is subtracted from the driver", default="")
    minus_input: str = place("input", "input column that is subtracted from the driver", default="")
    form: str = place("choice", "how the value follows the driver", choices=tuple(FORMS), default="constant")
    course: str = place("choice", "how the value depends on time", choices=tuple(COURSES), default="always")

    def nodes(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(node for node in (*self.own_nodes(), self.of, self.minus) if node))

    def own_nodes(self) -> tuple[str, ...]:
        """Return the nodes of the site."""
        return ()

    def inputs(self) -> tuple[str, ...]:
        stamp = STAMP if self.course != "always" else ""
        named = (*self.own_inputs(), self.driver, self.minus_input, stamp)
        return tuple(dict.fromkeys(column for column in named if column))

    def own_inputs(self) -> tuple[str, ...]:
        """Return the input columns of the site."""
        return ()

    @property
    def by_amount(self) -> bool:
        """Return True if the strength is the amount of a pulse."""
        return bool(self.total[0]) and self.form == "constant" and self.course == "pulse"

    @property
    def strength(self) -> str:
        """Return the name of the parameter that switches the law off at 0."""
        return "amount" if self.by_amount else FORMS[self.form][0]

    @property
    def follows_temperature(self) -> bool:
        """Return True if the value changes with a temperature between samples."""
        return bool(self.of or self.minus) and self.form not in ("constant", "threshold")

    def driver_units(self) -> tuple[str, str]:
        """Return the unit of the driver and that of its differences."""
        if not self.driver and (self.minus or self.minus_input):
            return "K", "K"
        if not self.driver:
            return "degC", "K"
        known = [suffix for suffix in UNITS_OF_SUFFIX if self.driver.endswith(f"_{suffix}")]
        suffix = max(known, key=len, default=self.driver.rsplit("_", 1)[-1])
        unit = UNITS_OF_SUFFIX[suffix][0] if known else suffix
        if unit == "degC":
            return ("K", "K") if self.minus or self.minus_input else ("degC", "K")
        return unit, f"({unit})" if "/" in unit else unit

    def parameter_specs(self) -> tuple[ParameterSpec, ...]:
        specs = form_specs(self.form, (self.unit_of_value(), self.most), self.driver_units())
        if self.by_amount:
            unit, most = self.total
            specs = (ParameterSpec("amount", unit, 0.0, -most, most, "tunable", "of the whole pulse; 0 without one"),)
        return (*self.own_specs(), *specs, *course_specs(self.course))

    def own_specs(self) -> tuple[ParameterSpec, ...]:
        """Return the parameters of the site."""
        return ()

    def unit_of_value(self) -> str:
        """Return the unit of the value."""
        return self.unit

    def problem(self, values: Mapping[str, float]) -> str | None:
        if "end_s" in COURSES[self.course] and values["end_s"] <= values["start_s"]:
            return "end_s must be later than start_s"
        given = [key for key in ("driver", "of") if getattr(self, key)]
        others = [key for key in ("minus", "minus_input") if getattr(self, key)]
        if self.form == "constant":
            return f"the form 'constant' follows nothing; leave {given[0]} out" if given or others else None
        if len(given) != 1:
            return f"the form {self.form!r} needs a driver: give either an input column (driver) or a node (of)"
        if len(others) > 1:
            return "only one temperature can be subtracted: leave minus or minus_input out"
        if others and self.driver and not self.driver.endswith("_C"):
            return f"driver {self.driver!r} is no temperature in degC, so none can be subtracted from it"
        if self.minus_input and not self.minus_input.endswith("_C"):
            return f"minus_input {self.minus_input!r} is no temperature in degC: its name does not end in _C"
        if self.minus and self.minus == self.of:
            return "minus names the same node as of"
        return None

    def driver_text(self, n: Names) -> str:
        """Return the driver as an expression."""
        if self.form == "constant":
            return ""
        x = n.temperature(self.of) if self.of else n.input(self.driver)
        if self.minus or self.minus_input:
            x = f"({x} - {n.temperature(self.minus) if self.minus else n.input(self.minus_input)})"
        return x

    def par(self, n: Names) -> Callable[[str], str]:
        """Return the function from a parameter's name to its expression."""
        if self.by_amount:
            return lambda name: f"({n.par('amount')} / {n.par('decay_s')})" if name == "size" else n.par(name)
        return n.par

    def memories(self, n: Names) -> tuple[SampleMemory, ...]:
        """Return the memory that is renewed once a sample."""
        x = self.driver_text(n)
        if self.form == "threshold":
            value, start = switch_text(x, n.par, n.before("switch"))
            return (SampleMemory("switch", value, n.local("switch"), start),)
        if self.form in REMEMBERING and not self.follows_temperature:
            value, after = follow_text(x, n.par, n.before("z"), n.span())
            return (SampleMemory("z", value, after, x),)
        return ()

    def value_text(self, n: Names, x: str, memory: str) -> str:
        """Return the value as an expression of the driver and of the memory."""
        text = form_text(self.form, x, self.par(n), memory)
        if self.follows_temperature:
            limit = LIMITS[self.unit_of_value()]
            text = f"min(max({text}, -{limit!r}), {limit!r})"
        course = course_text(self.course, n.input(STAMP), n.par) if self.course != "always" else ""
        return f"({text}) * ({course})" if course else f"({text})"

    def absent(self, n: Names) -> bool:
        """Return True if the kernel may leave the law out."""
        return n.constant(self.strength) == 0.0

    def parts(self, n: Names) -> Fragment:
        """Return the locals ``x``, ``value`` and ``slope`` of the law, and its memory."""
        memory = {"threshold": n.local("switch")}.get(self.form, n.local("z"))
        x, own = self.driver_text(n), list[tuple[str, str]]()
        states: tuple[ElementState, ...] = ()
        if x and self.form != "threshold":
            own.append((n.local("x"), x))
        if self.form in REMEMBERING and self.follows_temperature:
            memory, speed = n.state("z"), f"1.0 / {n.par('lag_s')}"
            states = (ElementState("z", rate=f"({n.local('x')} - {memory}) / {n.par('lag_s')}", start=x, speed=speed),)
        own.append((n.local("value"), self.value_text(n, n.local("x"), memory)))
        if self.follows_temperature:
            slope = (n.local("slope"), f"min({slope_text(self.form, self.par(n))}, {STEEPEST!r})")
            return Fragment(sample=(slope,), stage=tuple(own), states=states)
        return Fragment(sample=tuple(own), memories=self.memories(n))


@dataclass(frozen=True, kw_only=True)
class LawOfInput(Law):
    """Change of what the twin is given of an input column, which needs an element of kind actuator."""

    column: str = place("input", "input column that is changed; it needs an element of kind actuator")

    def own_inputs(self) -> tuple[str, ...]:
        return (self.column,)

    def problem(self, values: Mapping[str, float]) -> str | None:
        if self.follows_temperature:
            return "an input follows an input column; a temperature can only switch it (form 'threshold')"
        return super().problem(values)

    def changes(self) -> str:
        return input_target(self.column)

    def change(self, n: Names) -> str:
        if self.absent(n):
            return ""
        text = self.value_text(n, self.driver_text(n), n.local("switch" if self.form == "threshold" else "z"))
        return self.changed(re.sub(rf"\b{n.input(self.column)}\b", "{command}", text))

    @abstractmethod
    def changed(self, value: str) -> str:
        """Return the changed output as an expression of "{output}", the one without this law."""

    def emit(self, n: Names) -> Fragment:
        return Fragment() if self.absent(n) else Fragment(memories=self.memories(n))


def with_heat(parts: Fragment, heat: Mapping[str, str], conductance: Mapping[str, str]) -> Fragment:
    """Return the fragment of a law with its heat into nodes, and the bounds on its dependence on their temperatures."""
    return Fragment(
        sample=parts.sample,
        stage=parts.stage,
        heat=heat,
        conductance=conductance,
        states=parts.states,
        memories=parts.memories,
    )
