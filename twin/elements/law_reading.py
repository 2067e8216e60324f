"""Law of a reading: reading plus value K.

Driver, form and time course of the value, and the source of its balance: `law`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.base import Names, place
from twin.elements.fragments import Fragment
from twin.elements.law import REMEMBERING, Law
from twin.elements.law_forms import switch_text


@dataclass(frozen=True)
class LawReading(Law):
    """Change of the reading of a sensor; nothing but the reading depends on it."""

    kind: ClassVar[str] = "law_reading"
    unit: ClassVar[str] = "K"
    most: ClassVar[float] = 1.0e3

    sensor: str = place("element", "sensor whose reading is changed", kinds=("sensor",))

    def problem(self, values: Mapping[str, float]) -> str | None:
        if self.follows_temperature and self.form in REMEMBERING:
            return f"a reading has no form {self.form!r} of a temperature; the lag of a thermometer is its lag_s"
        return super().problem(values)

    def changes(self) -> str:
        return self.sensor

    def change(self, n: Names) -> str:
        if self.absent(n):
            return ""
        x, memory = self.driver_text(n), ""
        # A reading is taken at the sample: the switch looks there, and z has come to the end of the interval before.
        if self.form == "threshold":
            memory = f"({switch_text(x, n.par, n.before('switch'))[0]})"
        elif self.form in REMEMBERING:
            memory = n.before("z")
        return self.value_text(n, x, memory)

    def emit(self, n: Names) -> Fragment:
        return Fragment() if self.absent(n) else Fragment(memories=self.memories(n))
