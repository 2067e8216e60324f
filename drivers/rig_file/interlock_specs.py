"""Interlock and alarm sections of a rig file, `[[interlock]]` and `[[alarm]]`: watched points and limits.

A `warning` suspends the run (safe outputs, the profile's clock stands) until it clears; an `alarm` latches a trip.
Deadband and delays are those of ANSI/ISA-18.2: a condition must hold for `on_delay_s` before it counts, and be gone by
`deadband` for `off_delay_s` before it is over. A point that is stale or faulty counts as beyond its limit after the
rig's `abort_after_s`. An `[[alarm]]` only enters the alarm list of a run: it trips and suspends nothing.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.rig_file.plain_values import refuse_quoted_numbers

Level = Literal["warning", "alarm"]
Priority = Literal["critical", "high", "medium", "low"]
"""Priority of an alarm in the list of a run (ANSI/ISA-18.2, 10.3)."""


def require_bounds(what: str, low: float | None, high: float | None, deadband: float) -> None:
    """Check that there is a bound, and room for the deadband between two; raises ValueError."""
    if low is None and high is None:
        raise ValueError(f"{what} needs low, high or both")
    if low is not None and high is not None and high - low <= 2 * deadband:
        raise ValueError(f"between low {low:g} and high {high:g} there is no room for the deadband")


class _Spec(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_not_quoted(cls, data: Any) -> Any:
        refuse_quoted_numbers(cls, data)
        return data

    level: Level
    deadband: Annotated[float, Field(ge=0)] = 0.0
    on_delay_s: Annotated[float, Field(ge=0)] = 0.0
    off_delay_s: Annotated[float, Field(ge=0)] = 10.0
    priority: Priority | None = None
    doc: str = ""

    @property
    def points(self) -> dict[str, str]:
        """Names of the points that this interlock reads, by key."""
        keys = ("point", "heater", "flow", "setpoint")
        return {key: getattr(self, key) for key in keys if hasattr(self, key)}


class LimitSpec(_Spec):
    """Limit: `point` must stay between `low` and `high`, in its unit."""

    kind: Literal["limit"]
    point: str
    low: float | None = None
    high: float | None = None

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        require_bounds("a limit", self.low, self.high, self.deadband)
        return self


class RateOfRiseSpec(_Spec):
    """Rate of rise: `point` must not rise faster than `high` of its unit a second, over `window_s`."""

    kind: Literal["rate_of_rise"]
    point: str
    high: Annotated[float, Field(gt=0)]
    window_s: Annotated[float, Field(gt=0, le=3600)] = 10.0


class NoFlowSpec(_Spec):
    """No heat without flow: while `heater` is above `above`, `flow` must be at least `low`."""

    kind: Literal["no_flow"]
    heater: str
    above: Annotated[float, Field(ge=0)] = 0.0
    flow: str
    low: Annotated[float, Field(gt=0)]


class SensorSpec(_Spec):
    """Sensor check: `point` must not be stale, implausible or faulty for longer than the rig's `abort_after_s`."""

    kind: Literal["sensor"]
    point: str


class HeaterPowerSpec(_Spec):
    """Heater power check: `setpoint` and its `readback` must not differ by more than `tolerance`, in their unit.

    An `on_delay_s` of None stands for the set-point's `readback_within_s`, for the lag of the actuator.
    """

    kind: Literal["heater_power"]
    setpoint: str
    tolerance: Annotated[float, Field(gt=0)]
    on_delay_s: Annotated[float, Field(ge=0)] | None = None  # type: ignore[assignment]


class ResidualSpec(_Spec):
    """Residual check: measured minus predicted `sensor` (a name of the twin file) must stay within `high` kelvin.

    It is a warning only, since a wrong twin is no danger. The residual is a mean over the calibrator's block of some
    seconds.
    """

    kind: Literal["residual"]
    twin: str = "static"
    sensor: str
    high: Annotated[float, Field(gt=0)]

    @model_validator(mode="after")
    def _no_alarm(self) -> Self:
        if self.level != "warning":
            raise ValueError("a twin that is wrong is no danger to the rig; use level = 'warning'")
        return self


KINDS = ("limit", "rate_of_rise", "no_flow", "sensor", "heater_power", "residual")
InterlockSpec = Annotated[
    LimitSpec | RateOfRiseSpec | NoFlowSpec | SensorSpec | HeaterPowerSpec | ResidualSpec, Field(discriminator="kind")
]


class AlarmSpec(BaseModel):
    """Alarm on the good values of `point`, above `high` or below `low`, in its unit, for people alone.

    With `latch` it stays in the list until it is acknowledged after its cause has gone.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    point: str
    low: float | None = None
    high: float | None = None
    deadband: Annotated[float, Field(ge=0)] = 0.0
    on_delay_s: Annotated[float, Field(ge=0)] = 0.0
    off_delay_s: Annotated[float, Field(ge=0)] = 10.0
    priority: Priority = "medium"
    latch: bool = False
    doc: Annotated[str, Field(max_length=200)] = ""

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_not_quoted(cls, data: Any) -> Any:
        refuse_quoted_numbers(cls, data)
        return data

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        require_bounds("an alarm", self.low, self.high, self.deadband)
        return self
