"""Law of a flow: flow times (1 + value), or plus value L/min.

Driver, form and time course of the value, and the source of its balance: `law`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Names, place
from twin.elements.fragments import Fragment, SampleMemory
from twin.elements.law import MOST_SHARE, REMEMBERING, Law

MOST_FLOW = 1.0e4
"""Largest flow after a change in L/min, as much as the bounds of a flow allow with some to spare."""


@dataclass(frozen=True)
class LawFlow(Law):
    """Change of the flow of a `flow` element, as a share of it or in L/min."""

    kind: ClassVar[str] = "law_flow"
    unit: ClassVar[str] = "1"
    most: ClassVar[float] = 1.0e3

    flow: str = place("element", "flow element that is changed", kinds=("flow",))
    change_in: str = place("choice", "unit of the value", choices=("share", "L_min"), default="share")

    def unit_of_value(self) -> str:
        return "1" if self.change_in == "share" else "L/min"

    def problem(self, values: Mapping[str, float]) -> str | None:
        if self.follows_temperature and self.form in REMEMBERING:
            return f"a flow has no form {self.form!r} of a temperature; it follows one as it is at each sample"
        return super().problem(values)

    def changes(self) -> str:
        return self.flow

    def change(self, n: Names) -> str:
        if self.absent(n):
            return ""
        value = n.local("value")
        if self.change_in == "L_min":
            return f"min(max({{flow}} + {value} / 60.0, 0.0), {MOST_FLOW / 60.0!r})"
        return f"{{flow}} * min(max(1.0 + {value}, 0.0), {1.0 + MOST_SHARE!r})"

    def emit(self, n: Names) -> Fragment:
        if self.absent(n):
            return Fragment()
        if not self.follows_temperature:
            return self.parts(n)
        x, held = self.driver_text(n), n.local("held")
        return Fragment(
            sample=((n.local("value"), self.value_text(n, held, "")),), memories=(SampleMemory("held", x, held, x),)
        )
