"""Law of an actuator: its output times (1 + value).

Driver, form and time course of the value, and the source of its balance: `law`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from twin.elements.law import MOST_SHARE, LawOfInput


@dataclass(frozen=True)
class LawActuator(LawOfInput):
    """Relative change of the output of an actuator: 0.1 for a tenth more than commanded."""

    kind: ClassVar[str] = "law_actuator"
    unit: ClassVar[str] = "1"
    most: ClassVar[float] = 1.0e3

    def changed(self, value: str) -> str:
        return f"{{output}} * min(max(1.0 + {value}, 0.0), {1.0 + MOST_SHARE!r})"
