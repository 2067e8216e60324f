"""Statements of limits: the parsed form of a sentence such as `T_tank_C settles within 120 s to 0.5 K`.

Numbers have the units in which they are written. `hil.testing.bound_limits` relates them to the signals of a run.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

TIMES_S = {"ms": 1e-3, "s": 1.0, "sec": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
"""Units of time in a limit, s."""

Operator = Literal["<", "<=", ">", ">="]
Measure = Literal["value", "mean", "max", "min", "percentile", "deviation", "range", "time", "longest", "ramp"]


@dataclass(frozen=True, slots=True)
class Amount:
    """Number as it is written, with its unit; None where the sentence gives none."""

    number: float
    unit: str | None = None

    def __str__(self) -> str:
        unit = {None: "", "1": "", "degC": "°C"}.get(self.unit, self.unit)
        return f"{self.number:g} {unit}".rstrip()


@dataclass(frozen=True, slots=True)
class Bound:
    """Comparison with an amount; `upper` is the second amount of `between`, whose `operator` is `>=`."""

    operator: Operator
    amount: Amount
    upper: Amount | None = None

    def __str__(self) -> str:
        if self.upper is not None:
            return f"between {self.amount} and {self.upper}"
        return f"{self.operator} {self.amount}"


@dataclass(frozen=True, slots=True)
class While:
    """Condition on a signal: a limit counts only while the signal is on this side of an amount."""

    signal: str
    bound: Bound


@dataclass(frozen=True, slots=True)
class Window:
    """Times of a limit, s of profile time; None is the beginning or the end of the profile."""

    from_s: float | None = None
    to_s: float | None = None
    while_: While | None = None


@dataclass(frozen=True, slots=True)
class Compared:
    """Measure of a signal within a bound.

    `percent` is that of a percentile. `threshold` is the bound that the time of `time` and `longest` counts for.
    `over_s` is the span of a `ramp`, s, and `direction` 1 for rises alone, -1 for falls alone, 0 for both.
    """

    measure: Measure
    signal: str
    bound: Bound
    percent: float = 0.0
    threshold: Bound | None = None
    over_s: float | None = None
    direction: int = 0


@dataclass(frozen=True, slots=True)
class Settles:
    """Settling of a signal: within `within_s` it stays in `band` about `target`, None for its final value."""

    signal: str
    within_s: float
    band: Amount
    target: Amount | None = None


@dataclass(frozen=True, slots=True)
class Follows:
    """Reading of an actuator within `band` of its set-point, once that has been constant for `constant_s`."""

    signal: str
    band: Amount
    constant_s: float | None = None


@dataclass(frozen=True, slots=True)
class TwinError:
    """Error of a twin at one of its sensors: root mean square, mean, or largest absolute value."""

    kind: Literal["rmse", "bias", "largest"]
    twin: str
    sensor: str
    bound: Bound


@dataclass(frozen=True, slots=True)
class NoEffect:
    """Diagnosis of the run that finds no effect."""


@dataclass(frozen=True, slots=True)
class NoTrip:
    """Run without a trip of an interlock or of the rig."""


@dataclass(frozen=True, slots=True)
class Trips:
    """Trip of an interlock or of the rig that the test asks for; `signal` names its cause, None for any.

    `names` are the names of the signals that the reason of the trip may have.
    """

    signal: str | None = None
    names: tuple[str, ...] = ()


Statement = Compared | Settles | Follows | TwinError | NoEffect | NoTrip | Trips


@dataclass(frozen=True, slots=True)
class Sentence:
    """Statement of a limit and the times for which it holds."""

    statement: Statement
    window: Window
