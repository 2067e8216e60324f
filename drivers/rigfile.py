"""The rig file: TOML that says what is on the rig, parsed into frozen, validated objects.

Every mistake is reported with the file, the line, the key and what to do about it; all mistakes of a file come in one
`RigFileError`. Addresses are PDU addresses, zero-based (Modbus application protocol V1.1b3, 4.4).
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import tomllib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from drivers.codec import UNSIGNED, WIDTH, ByteOrder, CodecError, RegisterType, encode, raw_bounds, raw_sentinels
from drivers.interlock_specs import KINDS, HeaterPowerSpec, InterlockSpec
from drivers.points import ConfigurationError, Signal
from drivers.units import canonical_unit

Interval = tuple[float, float]


class RigFileError(ConfigurationError):
    """The rig file cannot be used; one sentence a mistake, each with line, key and remedy."""


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Table = Literal["coil", "discrete", "holding", "input"]


class Hole(_Section):
    """Addresses `first` to `last` of a table that the device has not; no request crosses them."""

    table: Table
    first: Annotated[int, Field(ge=0, le=65535)]
    last: Annotated[int, Field(ge=0, le=65535)]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.last < self.first:
            raise ValueError(f"a hole from {self.first} to {self.last} is none; give first and last in this order")
        return self


class ModbusTcpBus(_Section):
    """A Modbus/TCP server and the device behind it. `uptime` names the point that carries the device's own clock.

    `serial_baud` is the speed in bit/s of the line behind a gateway: what is polled must fit on it (`hil check`).
    """

    transport: Literal["modbus_tcp"]
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 502
    device_id: Annotated[int, Field(ge=0, le=255)] = 1
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 0.5
    max_read: Annotated[int, Field(ge=1, le=125)] = 125
    max_write: Annotated[int, Field(ge=1, le=123)] = 123
    max_gap: Annotated[int, Field(ge=0, le=124)] = 8
    max_read_bits: Annotated[int, Field(ge=1, le=2000)] = 2000
    max_write_bits: Annotated[int, Field(ge=1, le=1968)] = 1968
    hole: tuple[Hole, ...] = ()
    serial_baud: Annotated[int, Field(ge=300, le=4_000_000)] | None = None
    uptime: str | None = None


class ModbusTlsBus(ModbusTcpBus):
    """The same over TLS with certificates both ways (Modbus/TCP Security protocol specification, v21).

    `certificate` and `key` are ours, `ca` signs the device's: PEM files, beside the rig file unless their paths say
    otherwise. The device's certificate must name `host`.
    """

    transport: Literal["modbus_tls"]  # type: ignore[assignment]
    port: Annotated[int, Field(ge=1, le=65535)] = 802
    ca: Path
    certificate: Path
    key: Path


class CanBus(_Section):
    """A CAN bus reached through python-can, its frames described by a DBC file beside the rig file."""

    transport: Literal["socketcand", "socketcan"]
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 29536
    channel: str = "can0"
    dbc: Path
    dbc_encoding: str = "utf-8"
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 1.0
    uptime: str | None = None


class Point(_Section):
    """One quantity on a bus: where it is, how its raw value becomes an engineering value, and what it may be.

    engineering value = raw * scale + offset. A point with `access` `w` or `rw` is a set-point when it has `limits`.
    `bits` takes the lowest and the highest bit of an unsigned register, bit 0 being the least significant; `labels`
    names the numbers that an enumeration may have. A point of type `string` is `length` registers of text that is read
    once, when the rig is connected, and must be `expect` where that is given: a serial number, a firmware.
    """

    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
    bus: str
    unit: str
    access: Literal["r", "w", "rw"] = "r"
    role: str | None = None
    doc: str = ""
    # where: Modbus
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
    # where: CAN
    message: str | None = None
    signal: str | None = None
    # what a reading may be
    kind: Literal["measured", "status"] = "measured"
    invalid: tuple[Annotated[float, Field(allow_inf_nan=True)], ...] = ()
    plausible: Interval | None = None
    stale_after_s: Annotated[float, Field(gt=0)] = 3.0
    stuck_after_s: Annotated[float, Field(gt=0)] | None = None
    max_change_per_s: Annotated[float, Field(gt=0)] | None = None
    alarm: Interval | None = None
    # what may be written
    limits: Interval | None = None
    max_rate: Annotated[float, Field(gt=0)] | None = None
    safe_value: float | None = None
    safe_order: int = 0
    readback: str | None = None
    readback_tolerance: Annotated[float, Field(gt=0)] = 1.0
    readback_within_s: Annotated[float, Field(gt=0)] = 30.0

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
            if not self.limits[0] <= self.safe_value <= self.limits[1]:
                raise ValueError(f"safe_value {self.safe_value:g} is outside limits {list(self.limits)}")
        for mistake in (self._mistaken_type(), self._mistaken_number()):
            if mistake is not None:
                raise ValueError(mistake)
        return self

    def _mistaken_type(self) -> str | None:
        """What type, bits, labels and length say against one another, or None."""
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
        """A limit or safe value that cannot be written, or a sentinel that cannot come; None where all can."""
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
            scaled = (sentinel - self.offset) / self.scale
            met = any(low <= raw <= high for raw in (*raw_sentinels((sentinel,), self.type), scaled))
            if not met and not (math.isnan(sentinel) or self.type.startswith("float")):
                return f"invalid {sentinel:g} never comes out of a {self.type}; give the raw number, or its value"
        return None

    @property
    def is_setpoint(self) -> bool:
        """Whether profiles may drive this point."""
        return self.limits is not None

    @property
    def width(self) -> int:
        """Number of registers; of a coil or a discrete input one bit."""
        return WIDTH[self.type] if self.length is None else self.length

    @property
    def is_polled(self) -> bool:
        """Whether it is read on every tick."""
        return self.access == "r" and self.type != "string"

    @cached_property
    def sentinels(self) -> frozenset[float]:
        """Raw numbers that say that the sensor is faulty."""
        return raw_sentinels(self.invalid, self.type if self.table is not None else "float64")

    @cached_property
    def label_of(self) -> dict[int, str] | None:
        """Names of the numbers that an enumeration may have, or None."""
        return None if self.labels is None else {int(key): text for key, text in self.labels.items()}

    def as_signal(self) -> Signal:
        """The point without its address."""
        kind: Literal["measured", "setpoint", "status"] = "setpoint" if self.is_setpoint else self.kind
        return Signal(self.name, self.unit, kind, self.role, self.bus, self.plausible, self.doc)


class Heartbeat(_Section):
    """How rig and harness watch each other: the harness changes `point` each tick, the rig's `counter` must advance.

    `arm` is the point that lets outputs go live when 1 is written. The rig says on `status` that it has tripped by
    itself: any bit of `trip_mask`. Those of `watchdog_mask` say no more than that the heartbeat stayed away, as it does
    after every run; any other must be acknowledged before the next one starts. `counter` must advance within
    `timeout_s`.

    `watchdog` is the point, in s, that says how long the rig waits for a beat before it cuts its heater itself. Where
    it is named the harness sets it before it arms (`Rig.watchdog_s`), and arms no rig that does not hold it.
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


class Rig(_Section):
    """A whole rig file. `twin` is the twin file that runs beside this rig unless another is named.

    A run that an alarm has tripped waits `acknowledge_within_s` at safe values for an operator; 0 ends it at once. One
    that a warning suspends waits `suspend_at_most_s` for it to go away; 0 is for as long as it takes.
    """

    name: str
    description: str = ""
    period_s: Annotated[float, Field(gt=0, le=3600)] = 1.0
    abort_after_s: Annotated[float, Field(gt=0)] = 5.0
    acknowledge_within_s: Annotated[float, Field(ge=0)] = 0.0
    suspend_at_most_s: Annotated[float, Field(ge=0)] = 0.0
    twin: Path | None = None
    heartbeat: Heartbeat | None = None
    bus: dict[str, Annotated[ModbusTcpBus | ModbusTlsBus | CanBus, Field(discriminator="transport")]]
    point: tuple[Point, ...]
    interlock: tuple[InterlockSpec, ...] = ()

    @property
    def setpoints(self) -> tuple[Point, ...]:
        """Points that a profile may drive, in file order."""
        return tuple(point for point in self.point if point.is_setpoint)

    @property
    def watchdog_s(self) -> float | None:
        """Time-out that the harness gives the rig's own watchdog, s; None where it is not told how.

        As the rig file says, else `abort_after_s`: with the link gone the rig need not wait longer than the harness.
        Rounded down to what the point can hold.
        """
        if self.heartbeat is None or self.heartbeat.watchdog is None:
            return None
        wanted, point = self.heartbeat.watchdog_s or self.abort_after_s, self.get(self.heartbeat.watchdog)
        if point.type.startswith("float"):
            return wanted
        return math.floor((wanted - point.offset) / point.scale + 1e-9) * point.scale + point.offset

    def get(self, name: str) -> Point:
        """The point called `name`; KeyError where there is none."""
        for point in self.point:
            if point.name == name:
                return point
        raise KeyError(name)

    def setpoint_of_column(self, name: str) -> Point | None:
        """The set-point that a profile calls `name`: its own name or the name of the point it moves."""
        return next((p for p in self.setpoints if name in (p.name, p.readback)), None)

    def with_ports(self, ports: dict[str, int]) -> Rig:
        """The same rig with other TCP ports, by bus name."""
        buses = {name: bus.model_copy(update={"port": ports.get(name, bus.port)}) for name, bus in self.bus.items()}
        return self.model_copy(update={"bus": buses})


_FILES = ("dbc", "ca", "certificate", "key")


def load_rig(path: Path) -> Rig:
    """Read and validate a rig file; raises RigFileError with every mistake in it."""
    try:
        raw = path.read_bytes()
        text = raw.decode("utf-8")
        document = tomllib.loads(text)
    except FileNotFoundError:
        raise RigFileError(f"{path}: there is no such file; give the path of a rig file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RigFileError(f"{path}: cannot be read ({error}); save it as UTF-8 text") from error
    except tomllib.TOMLDecodeError as error:
        raise RigFileError(f"{path}: is not valid TOML: {error}") from error
    for section in document.get("bus", {}).values():
        for key in _FILES:
            if isinstance(section, dict) and isinstance(section.get(key), str):
                section[key] = os.path.normpath(path.parent / section[key])
    document = {**document.pop("rig", {}), **document}
    if isinstance(document.get("twin"), str):
        document["twin"] = os.path.normpath(path.parent / document["twin"])
    try:
        rig = Rig.model_validate(document)
    except ValidationError as error:
        sentences = [_sentence(path, text, item) for item in error.errors()]
        raise RigFileError("\n".join(dict.fromkeys(sentences))) from None
    mistakes = [f"{path}, line {_line(text, place)}: {what}" for place, what in _cross_checks(rig)]
    if mistakes:
        raise RigFileError("\n".join(mistakes))
    return rig


def located(path: Path, mistakes: Sequence[tuple[Sequence[Any], str]]) -> RigFileError:
    """The error of mistakes that were found in a rig file after it was read, each with its place in the document."""
    text = path.read_text(encoding="utf-8")
    return RigFileError("\n".join(f"{path}, line {_line(text, place)}: {what}" for place, what in mistakes))


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _cross_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Mistakes that need more than one section, with their place in the document."""
    found: list[tuple[tuple[Any, ...], str]] = []
    names: dict[str, int] = {}
    taken = Layout()
    for index, point in enumerate(rig.point):
        place = ("point", index)
        if point.name in names:
            found.append(((*place, "name"), f"a second point is called {point.name!r}; names must differ"))
        names[point.name] = index
        bus = rig.bus.get(point.bus)
        if bus is None:
            found.append(((*place, "bus"), f"{point.name}: no bus {point.bus!r}; there is {', '.join(rig.bus)}"))
            continue
        if isinstance(bus, CanBus):
            if point.message is None or point.signal is None:
                found.append((place, f"{point.name}: a point on CAN needs message and signal, as in the DBC"))
            if point.access != "r":
                found.append(((*place, "access"), f"{point.name}: points on CAN are read only; take access out"))
            continue
        if point.table is None or point.address is None:
            found.append(
                (
                    place,
                    f"{point.name}: a point on Modbus needs table (holding, input, coil or discrete) and address",
                )
            )
            continue
        if point.access != "r" and point.table in ("input", "discrete"):
            which, other = ("input registers", "holding") if point.table == "input" else ("discrete inputs", "coil")
            found.append(((*place, "table"), f"{point.name}: {which} cannot be written; use table '{other}'"))
        found += [((*place, key), f"{point.name}: {what}") for key, what in misplaced(point, bus)]
        clash = taken.taken_by(point)
        if clash is not None:
            unit = "" if point.table in ("coil", "discrete") else " register"
            found.append(
                (
                    (*place, "address"),
                    f"{point.name}: {point.table}{unit} {clash[1]} is {clash[0]}'s already; correct one address",
                )
            )
        if point.is_setpoint and point.readback is not None:
            target = next((other for other in rig.point if other.name == point.readback), None)
            if target is None:
                found.append(((*place, "readback"), f"{point.name}: no point {point.readback!r} to read back"))
            elif target.unit != point.unit:
                found.append(
                    ((*place, "readback"), f"{point.name} is in {point.unit} but {target.name} in {target.unit}")
                )
    for name, bus in rig.bus.items():
        if bus.uptime is not None and not any(p.name == bus.uptime and p.bus == name for p in rig.point):
            found.append((("bus", name, "uptime"), f"bus {name}: no point {bus.uptime!r} on this bus for uptime"))
    if rig.heartbeat is not None:
        for key in ("point", "counter", "arm", "status", "watchdog"):
            named = getattr(rig.heartbeat, key)
            if named is not None and named not in names:
                found.append((("heartbeat", key), f"heartbeat: no point {named!r}; declare it or correct {key}"))
    return found + _watchdog_checks(rig) + _interlock_checks(rig)


def _watchdog_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Why the rig's watchdog cannot be given its time-out."""
    heartbeat, place = rig.heartbeat, ("heartbeat", "watchdog")
    if heartbeat is not None and heartbeat.watchdog is None and heartbeat.watchdog_s is not None:
        return [(("heartbeat", "watchdog_s"), "heartbeat: watchdog_s is written to a point; name it as watchdog")]
    point = next((p for p in rig.point if heartbeat is not None and p.name == heartbeat.watchdog), None)
    if point is None:
        return []
    if point.access == "r" or point.is_setpoint or point.unit != "s":
        return [(place, f"heartbeat: {point.name} must be in s, have access 'rw' and no limits, to hold a time-out")]
    seconds = rig.watchdog_s or 0.0
    if seconds < 2.0 * rig.period_s:
        return [
            (
                place,
                f"heartbeat: a watchdog of {seconds:g} s would cut the heater between two beats; "
                f"make watchdog_s (else abort_after_s) at least two periods, {2.0 * rig.period_s:g} s",
            )
        ]
    try:
        encode((seconds - point.offset) / point.scale, point.type, point.order)
    except CodecError as error:
        return [(place, f"heartbeat: {seconds:g} s cannot be written to {point.name}: raw {error}; shorten watchdog_s")]
    return []


def misplaced(point: Point, bus: ModbusTcpBus) -> list[tuple[str, str]]:
    """Key and mistake of a Modbus point that its bus cannot carry."""
    first = point.address or 0
    last = first + point.width - 1
    found: list[tuple[str, str]] = []
    if last > 65535:
        found.append(("address", f"ends at {last} and the last address is 65535; correct the address or the type"))
    most = bus.max_read if point.access == "r" else min(bus.max_read, bus.max_write)
    if point.width > most:
        found.append(("type", f"{point.type} takes {point.width} registers and one request {most}; raise max_read"))
    for hole in bus.hole:
        if hole.table == point.table and first <= hole.last and hole.first <= last:
            found.append(("address", f"is in the hole {hole.first} to {hole.last} of its bus; correct one of them"))
    return found


class Layout:
    """Which addresses belong to whom. Bit fields may share registers where their bits differ."""

    def __init__(self) -> None:
        self._taken: dict[tuple[str, str, int], list[Point]] = {}

    def taken_by(self, point: Point) -> tuple[str, int] | None:
        """Take the addresses of a Modbus point; name and address of another point that has one of them already."""
        first = point.address or 0
        clash: tuple[str, int] | None = None
        for address in range(first, first + point.width):
            others = self._taken.setdefault((point.bus, str(point.table), address), [])
            for other in others:
                if clash is None and other is not point and not _share(point, other):
                    clash = other.name, address
            others.append(point)
        return clash


def _share(one: Point, other: Point) -> bool:
    if one.bits is None or other.bits is None:
        return False
    same = (one.address, one.type, one.order) == (other.address, other.type, other.order)
    return same and (one.bits[1] < other.bits[0] or other.bits[1] < one.bits[0])


def _interlock_checks(rig: Rig) -> list[tuple[tuple[Any, ...], str]]:
    """Interlocks that watch what there is not."""
    found: list[tuple[tuple[Any, ...], str]] = []
    points = {point.name: point for point in rig.point}
    for index, spec in enumerate(rig.interlock):
        for key, name in spec.points.items():
            point, place = points.get(name), ("interlock", index, key)
            if point is None:
                found.append((place, f"{spec.kind}: no point {name!r}; declare it or correct {key}"))
            elif not (point.is_setpoint if key == "setpoint" else point.is_polled):
                what = "a set-point" if key == "setpoint" else "read on every tick (access = 'r')"
                found.append((place, f"{spec.kind}: {name} is not {what}; correct {key}"))
            elif isinstance(spec, HeaterPowerSpec) and point.readback is None:
                found.append((place, f"{spec.kind}: {name} has no readback to compare with; add one to the point"))
    return found


_KEY = re.compile(r"^\s*(?:\"([^\"]+)\"|([A-Za-z0-9_\-]+))\s*=")


def _line(text: str, place: Sequence[Any]) -> int:
    """Line (from 1) of a place such as ('point', 3, 'order') in TOML text; the section's line where the key is not."""
    section = str(place[0]) if place else ""
    rest = list(place[1:])
    lines = text.splitlines()
    start = 0
    if rest and isinstance(rest[0], int):
        header, count = f"[[{section}]]", rest.pop(0)
        hits = [n for n, line in enumerate(lines) if line.split("#")[0].strip() == header]
        start = hits[count] if count < len(hits) else 0
    else:
        if rest and section == "bus":
            section = f"bus.{rest.pop(0)}"
        wanted = {f"[{section}]", f"[[{section}]]"}
        hits = [n for n, line in enumerate(lines) if line.split("#")[0].strip() in wanted]
        if hits:
            start = hits[0]
        else:
            rest = [section]
    keys = {str(item) for item in rest}
    for number in range(start, len(lines)):
        if number > start and lines[number].lstrip().startswith("["):
            if hits or start:
                break
            continue
        match = _KEY.match(lines[number])
        if match and (match[1] or match[2]) in keys:
            return number + 1
    return start + 1


_TAGS = ("modbus_tcp", "modbus_tls", "socketcand", "socketcan", *KINDS)
"""Which member of a union was meant: pydantic puts it into the place of a mistake."""
_REMEDY = {
    "missing": "is missing; add it",
    "extra_forbidden": "is not a key of this section; check its spelling",
}


def _sentence(path: Path, text: str, item: Any) -> str:
    place = tuple(part for part in item["loc"] if part not in _TAGS)
    what = _REMEDY.get(item["type"], item["msg"].removeprefix("Value error, "))
    if item["type"] == "literal_error":
        what = f"{item['input']!r} is not known; use {item['ctx']['expected']}"
    elif item["type"] == "union_tag_invalid":
        key = item["ctx"]["discriminator"].strip("'")
        what = f"{key} {item['input'].get(key)!r} is not known; use {item['ctx']['expected_tags']}"
    elif item["type"] not in ("missing", "extra_forbidden", "value_error") and not isinstance(item["input"], dict):
        what = f"{what}, got {item['input']!r}"
    key = ".".join(str(part) for part in place if not isinstance(part, int))
    owner = ""
    if len(place) > 1 and place[0] == "point" and isinstance(place[1], int):
        points = tomllib.loads(text).get("point", [])
        name = points[place[1]].get("name") if place[1] < len(points) else None
        key = str(place[2]) if len(place) > 2 else "point"
        owner = f" of point {name or place[1]}"
    return f"{path}, line {_line(text, place)}: {key}{owner}: {what}"
