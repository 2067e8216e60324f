"""Signals, their quality, one tick's readings, and the errors of drivers."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Literal

from drivers.signals.units import column_name


class Quality(enum.IntEnum):
    """Quality of a value. A value that is not GOOD is recorded with its quality and never given to a twin."""

    GOOD = 0
    STALE = 1  # older than the point's stale_after
    OUT_OF_RANGE = 2  # outside the point's plausible range
    SENSOR_FAULT = 3  # the device says so, or a sentinel value
    LINK_FAULT = 4  # no valid reply on this tick


@dataclass(frozen=True, slots=True)
class Signal:
    """Named quantity of the rig, without its address.

    `kind` is `measured` for readings, `setpoint` for values that the harness writes, `status` for counters and bit
    fields, which no twin and no plot uses. `plausible` is a range in `unit`. `readback` is the name of the signal that
    measures what a set-point moves.
    """

    name: str
    unit: str
    kind: Literal["measured", "setpoint", "status"] = "measured"
    role: str | None = None
    bus: str = ""
    plausible: tuple[float, float] | None = None
    doc: str = ""
    readback: str | None = None

    @property
    def column(self) -> str:
        """Name of this signal's column in a record, with the unit as suffix."""
        return column_name(self.name, self.unit)


@dataclass(slots=True)
class Snapshot:
    """Readings of one tick, in the order of the rig's signals.

    `source_time_s` is the rig's own clock where it has one, else the harness's; NaN where nothing arrived yet.
    A value whose quality is not GOOD is the received one (or NaN), never the last good one.
    """

    values: list[float]
    quality: list[int]
    source_time_s: list[float]
    faults: list[str] = field(default_factory=list)


class DriverError(Exception):
    """Base of all errors of drivers; exceptions of libraries are converted to them."""


class ConfigurationError(DriverError, ValueError):
    """Error of a rig file, a DBC or a request; retrying cannot help."""


class LinkError(DriverError, ConnectionError):
    """Error of a wire that is down, mute or closed."""


class DeadlineError(LinkError, TimeoutError):
    """Error of a request without an answer within its deadline."""


class LateReplyError(DeadlineError):
    """Error of a reply that waited in a queue while this process did not run: its values are old."""


class ProtocolError(DriverError):
    """Error of an answer that the request does not admit."""


class DeviceExceptionError(ProtocolError):
    """Error of a Modbus exception reply; `code` is the exception code (Modbus application protocol, 7)."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code
