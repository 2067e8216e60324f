"""What crosses the wall between a bus and the harness: signals, their quality, and one tick's readings."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Literal

from drivers.signals.units import column_name


class Quality(enum.IntEnum):
    """How far a value can be trusted. Anything but GOOD is kept with its reason and never fed to a twin."""

    GOOD = 0
    STALE = 1  # older than the point's stale_after
    OUT_OF_RANGE = 2  # outside the point's plausible range
    SENSOR_FAULT = 3  # the device says so, or a sentinel value
    LINK_FAULT = 4  # no valid reply on this tick


@dataclass(frozen=True, slots=True)
class Signal:
    """One named quantity of the rig as the rest of the project sees it, without its address.

    `kind` is `measured` for what the rig reports, `setpoint` for what the harness writes, `status` for counters
    and bit fields that no twin and no plot wants.
    """

    name: str
    unit: str
    kind: Literal["measured", "setpoint", "status"] = "measured"
    role: str | None = None
    bus: str = ""
    plausible: tuple[float, float] | None = None
    doc: str = ""

    @property
    def column(self) -> str:
        """Name of this signal's column in a record, with the unit as suffix."""
        return column_name(self.name, self.unit)


@dataclass(slots=True)
class Snapshot:
    """Readings of one tick, in the order of the rig's signals.

    `source_time_s` is the rig's own clock where it has one, else the harness's; NaN where nothing arrived yet.
    A value whose quality is not GOOD is what was received (or NaN), never the last good one.
    """

    values: list[float]
    quality: list[int]
    source_time_s: list[float]
    faults: list[str] = field(default_factory=list)


class DriverError(Exception):
    """Root of everything a driver raises; foreign exceptions are converted at the edge."""


class ConfigurationError(DriverError, ValueError):
    """The rig file, a DBC or a request is wrong; retrying cannot help."""


class LinkError(DriverError, ConnectionError):
    """The wire is down, mute or closed."""


class DeadlineError(LinkError, TimeoutError):
    """No answer within the deadline."""


class LateReplyError(DeadlineError):
    """A reply that lay in a queue while this process did not run: it says how things were before."""


class ProtocolError(DriverError):
    """The device answered something that the request does not admit."""


class DeviceExceptionError(ProtocolError):
    """The device answered a Modbus exception; `code` is the exception code (Modbus application protocol, 7)."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code
