"""Law of an input: temperature of its column less value K, by which its thermometer reads too high.

Driver, form and time course of the value, and the source of its balance: `law`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from twin.elements.law import LawOfInput


@dataclass(frozen=True)
class LawInput(LawOfInput):
    """Error of the thermometer of an input column, such as the room's: it reads value K too high."""

    kind: ClassVar[str] = "law_input"
    unit: ClassVar[str] = "K"
    most: ClassVar[float] = 1.0e3

    def problem(self, values: Mapping[str, float]) -> str | None:
        if not self.column.endswith("_C"):
            return f"column {self.column!r} is no temperature in degC: its name does not end in _C"
        return super().problem(values)

    def changed(self, value: str) -> str:
        return f"{{output}} - {value}"
