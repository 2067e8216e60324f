"""Model of a rig file: points, heartbeat and the whole rig as frozen, validated objects.

Addresses are PDU addresses, zero-based (Modbus application protocol V1.1b3, 4.4).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from drivers.rig_file.bus_sections import AnyBus, Section, Table
from drivers.rig_file.interlock_specs import AlarmSpec, InterlockSpec
from drivers.signals import (
    UNSIGNED,
    WIDTH,
    ByteOrder,
    CodecError,
    RegisterType,
    Signal,
    canonical_unit,
    encode,
    raw_bounds,
    raw_sentinels,
)

Interval = tuple[float, float]


def _tolerance(sentinel: float) -> float:
    """Return the difference by which raw * scale + offset may miss a sentinel for rounding alone."""
    return 1e-9 * max(1.0, abs(sentinel))


LONGEST_NAME = 120
"""Most characters of the name of a point or bus: alarms and columns append to it, and pages show it."""


class Point(Section):
    """Quantity on a bus: its place, the conversion of its raw value, its limits and its checks.

    engineering value = raw * scale + offset. A point with `access` `w` or `rw` is a set-point when it has `limits`.
    `bits` takes the lowest and the highest bit of an unsigned register, bit 0 being the least significant; `labels`
    names the numbers that an enumeration may have. A point of type `string` is `length` registers of text that is read
    once, when the rig is connected, and must be `expect` where that is given: a serial number, a firmware.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$", max_length=LONGEST_NAME)]
    bus: str
    unit: str
    access: Literal["r", "w", "rw"] = "r"
    role: str | None = None
    doc: str = ""
    # place on Modbus
    table: Table | None = None
    address: Annotated[int, Field(ge=0, le=65535)] | None = None
    type: RegisterType = "uint16"
    order: ByteOrder = "ABCD"
    scale: float = 1.0
    offset: float = 0.0
    bits: tuple[Annotated[int, Field(ge=0, le=63)], Annotated[int, Field(ge=0, le=63)]] | None = None
    labels: dict[str, str] | None = None
    length: Annotated[int, Field(ge=1, le=125)] | None = None
    expect: str | None = None
    # place on CAN
    message: str | None = None
    signal: str | None = None
    # checks of readings
    kind: Literal["measured", "status"] = "measured"
    invalid: tuple[Annotated[float, Field(allow_inf_nan=True)], ...] = ()
    plausible: Interval | None = None
    stale_after_s: Annotated[float, Field(gt=0)] = 3.0
    stuck_after_s: Annotated[float, Field(gt=0)] | None = None
    max_change_per_s: Annotated[float, Field(gt=0)] | None = None
    alarm: Interval | None = None
    # limits of writes
    limits: Interval | None = None
    max_rate: Annotated[float, Field(gt=0)] | None = None
    safe_value: float | None = None
    safe_order: int = 0
    readback: str | None = None
    readback_tolerance: Annotated[float, Field(gt=0)] = 1.0
    readback_within_s: Annotated[float, Field(gt=0)] = 30.0
    safe_below: float | None = None

    @model_validator(mode="before")
    @classmethod
    def _bits_are_bool(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("table") in ("coil", "discrete"):
            return {"type": "bool", **data}
        return data

    @field_validator("unit")
    @classmethod
    def _known_unit(cls, unit: str) -> str:
        return canonical_unit(unit)

    @field_validator("plausible", "alarm", "limits")
    @classmethod
    def _ordered(cls, interval: Interval | None) -> Interval | None:
        if interval is not None and interval[0] >= interval[1]:
            raise ValueError(f"the lower bound {interval[0]:g} must be below the upper bound {interval[1]:g}")
        return interval

    @field_validator("scale")
    @classmethod
    def _invertible(cls, scale: float) -> float:
        if scale == 0:
            raise ValueError("a scale of 0 loses the value; give the engineering value of one raw count")
        return scale

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.limits is not None:
            if self.access == "r":
                raise ValueError("has limits, which are for set-points; add access = 'rw' or take limits out")
            if self.safe_value is None:
                raise ValueError("is a set-point without safe_value; give the value that it is left at")
            if self.safe_below is not None and self.readback is None:
                raise ValueError(
                    "has safe_below, which is a reading of its meter; add readback, or take safe_below out"
                )
            if not self.limits[0] <= self.safe_value <= self.limits[1]:
                raise ValueError(f"safe_value {self.safe_value:g} is outside limits {list(self.limits)}")
        for mistake in (self._mistaken_type(), self._mistaken_number()):
            if mistake is not None:
                raise ValueError(mistake)
        return self

    def _mistaken_type(self) -> str | None:
        """Return the contradiction between type, bits, labels and length, or None."""
        if self.table in ("coil", "discrete") and self.type != "bool":
            return f"a {self.table} is one bit and has no type {self.type}; take type out"
        if (self.length is not None) != (self.type == "string"):
            return "length is the number of registers of a string; give it with type = 'string', and only there"
        if self.type == "string":
            if self.access != "r" or self.order not in ("ABCD", "BADC"):
                return "a string is only read, in order 'ABCD' or 'BADC'; take access or order out"
            if self.bits is not None or self.labels is not None or self.invalid:
                return "a string has neither bits nor labels nor invalid; take them out"
        elif self.expect is not None:
            return "expect is the text that a point of type = 'string' must have; take it out"
        if self.bits is not None:
            if self.type not in UNSIGNED or not self.bits[0] <= self.bits[1] < 16 * self.width:
                return (
                    f"bits {list(self.bits)} are the lowest and the highest bit of an unsigned integer; "
                    f"{self.type} has {16 * self.width if self.type in UNSIGNED else 'none'}"
                )
            if self.access != "r":
                return "bits of a register can only be read here; write the whole register, as a point without bits"
        if self.labels is not None:
            if any(re.fullmatch(r"-?\d{1,19}", key) is None for key in self.labels):
                return "labels name whole numbers; write them as labels = { 0 = 'off', 1 = 'on' }"
            if self.type.startswith("float") or self.scale != 1.0 or self.offset != 0.0:
                return "labels name raw whole numbers; take scale and offset out, and use an integer type"
        return None

    def _mistaken_number(self) -> str | None:
        """Return a sentence about a limit or safe value out of the type's range or an impossible sentinel, or None."""
        if self.table is None or self.type == "string":
            return None
        written = [*(self.limits or ()), *([] if self.safe_value is None else [self.safe_value])]
        for value in written:
            try:
                encode((value - self.offset) / self.scale, self.type, self.order)
            except CodecError as error:
                return f"{value:g} {self.unit} cannot be written: raw {error}; correct type, scale or limits"
        low, high = raw_bounds(self.type, self.bits)
        for sentinel in self.invalid:
            met = any(low <= raw <= high and raw == math.floor(raw) for raw in self._raw_of(sentinel))
            if not met and not (math.isnan(sentinel) or self.type.startswith("float")):
                return f"invalid {sentinel:g} never comes out of a {self.type}; give the raw number, or its value"
        return None

    def _raw_of(self, sentinel: float) -> Iterator[float]:
        """Yield the raw numbers that a sentinel may stand for: itself, and the whole one that gives its value."""
        yield from (raw for raw in raw_sentinels((sentinel,), self.type) if math.isfinite(raw))
        scaled = (sentinel - self.offset) / self.scale
        if math.isfinite(scaled):
            value = round(scaled) * self.scale + self.offset
            if abs(value - sentinel) <= _tolerance(sentinel):
                yield float(round(scaled))

    @property
    def is_setpoint(self) -> bool:
        """True where profiles may drive this point."""
        return self.limits is not None

    @property
    def width(self) -> int:
        """Number of registers; 1 (bit) for a coil or a discrete input."""
        return WIDTH[self.type] if self.length is None else self.length

    @property
    def is_polled(self) -> bool:
        """True where it is read on every tick."""
        return self.access == "r" and self.type != "string"

    @cached_property
    def sentinels(self) -> frozenset[float]:
        """Raw numbers that mean a faulty sensor."""
        return raw_sentinels(self.invalid, self.type if self.table is not None else "float64")

    @property
    def scaled_sentinels(self) -> tuple[tuple[float, float], ...]:
        """Values in the unit that mean a faulty sensor, each with the tolerance within which a value equals it."""
        return tuple((sentinel, _tolerance(sentinel)) for sentinel in self.invalid)

    @cached_property
    def label_of(self) -> dict[int, str] | None:
        """Names of the numbers that an enumeration may have, or None."""
        return None if self.labels is None else {int(key): text for key, text in self.labels.items()}

    def as_signal(self) -> Signal:
        """Return the point without its address."""
        kind: Literal["measured", "setpoint", "status"] = "setpoint" if self.is_setpoint else self.kind
        return Signal(self.name, self.unit, kind, self.role, self.bus, self.plausible, self.doc, self.readback)


class Heartbeat(Section):
    """Mutual supervision of rig and harness: the harness changes `point` each tick, the rig's `counter` must advance.

    `arm` is the point that enables the outputs when 1 is written. The rig reports its own trip on `status`: any bit of
    `trip_mask`. A bit of `watchdog_mask` means only that the heartbeat stopped, as it does after every run; any other
    bit must be acknowledged before the next run starts. `counter` must advance within `timeout_s`.

    `watchdog` is the point that holds the rig's time-out in s: the rig waits so long for a beat before it cuts its
    heater itself. If it is named, the harness sets it before it arms (`Rig.watchdog_s`), and arms no rig that does not
    hold it.
    """

    point: str
    counter: str | None = None
    arm: str | None = None
    status: str | None = None
    trip_mask: Annotated[int, Field(ge=0, le=65535)] = 0
    watchdog_mask: Annotated[int, Field(ge=0, le=65535)] = 0
    watchdog: str | None = None
    watchdog_s: Annotated[float, Field(gt=0)] | None = None
    timeout_s: Annotated[float, Field(gt=0)] = 10.0


class Rig(Section):
    """Whole rig file. `twin` is the twin file of this rig, unless a command names another.

    A run that an alarm has tripped waits `acknowledge_within_s` at safe values for an operator; 0 ends it at once. A
    run that a warning suspends waits `suspend_at_most_s` for it to clear; 0 means without limit.

    The clock of the rig runs `time_scale` times real time, as that of a simulated device may. All times in the file are
    in rig time, except those of a bus, which are in real time.
    """

    name: str
    description: str = ""
    period_s: Annotated[float, Field(gt=0, le=3600)] = 1.0
    time_scale: Annotated[float, Field(gt=0, le=100)] = 1.0
    abort_after_s: Annotated[float, Field(gt=0)] = 5.0
    acknowledge_within_s: Annotated[float, Field(ge=0)] = 0.0
    suspend_at_most_s: Annotated[float, Field(ge=0)] = 0.0
    twin: Path | None = None
    heartbeat: Heartbeat | None = None
    bus: dict[Annotated[str, Field(max_length=LONGEST_NAME)], Annotated[AnyBus, Field(discriminator="transport")]]
    point: tuple[Point, ...]
    interlock: tuple[InterlockSpec, ...] = ()
    alarm: tuple[AlarmSpec, ...] = ()

    @field_validator("name")
    @classmethod
    def _is_printable(cls, name: str) -> str:
        if not name.isprintable():
            raise ValueError("has a control character in it; use printable characters only")
        return name

    @property
    def setpoints(self) -> tuple[Point, ...]:
        """Points that a profile may drive, in file order."""
        return tuple(point for point in self.point if point.is_setpoint)

    @property
    def unlimited(self) -> tuple[Point, ...]:
        """Points that may be written and have no limits, but for states and those of the heartbeat, in file order."""
        beat = self.heartbeat
        named = () if beat is None else (beat.point, beat.arm, beat.watchdog)
        return tuple(
            point
            for point in self.point
            if point.access != "r" and not point.is_setpoint and point.kind == "measured" and point.name not in named
        )

    @property
    def watchdog_s(self) -> float | None:
        """Time-out that the harness sets for the rig's own watchdog, s; None where no watchdog point is declared.

        It is the rig file's, else `abort_after_s`: with the link gone the rig need not wait longer than the harness.
        Rounded down to what the point can hold.
        """
        if self.heartbeat is None or self.heartbeat.watchdog is None:
            return None
        wanted, point = self.heartbeat.watchdog_s or self.abort_after_s, self.get(self.heartbeat.watchdog)
        if point.type.startswith("float"):
            return wanted
        return math.floor((wanted - point.offset) / point.scale + 1e-9) * point.scale + point.offset

    def get(self, name: str) -> Point:
        """Return the point called `name`; raise KeyError where there is none."""
        for point in self.point:
            if point.name == name:
                return point
        raise KeyError(name)

    def setpoint_of_column(self, name: str) -> Point | None:
        """Return the set-point for a profile's column `name` (its own name or its readback's), or None."""
        return next((p for p in self.setpoints if name in (p.name, p.readback)), None)

    def with_ports(self, ports: dict[str, int]) -> Rig:
        """Return the same rig with other TCP ports, by bus name."""
        buses = {
            name: bus.model_copy(update={"port": ports[name]}) if name in ports else bus
            for name, bus in self.bus.items()
        }
        return self.model_copy(update={"bus": buses})
