"""Sections of a rig file that say how a bus is reached, `[bus.NAME]`: one class a transport, validated."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class Section(BaseModel):
    """One section of a rig file: unknown keys are mistakes, and so are infinite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Table = Literal["coil", "discrete", "holding", "input"]


class Hole(Section):
    """Addresses `first` to `last` of a table that the device has not; no request crosses them."""

    table: Table
    first: Annotated[int, Field(ge=0, le=65535)]
    last: Annotated[int, Field(ge=0, le=65535)]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.last < self.first:
            raise ValueError(f"a hole from {self.first} to {self.last} is none; give first and last in this order")
        return self


class ModbusBusSection(Section, ABC):
    """A Modbus device, however it is reached. Sections of the same line, or the same host and port, share that wire.

    `timeout_s` is what the device may take to answer, without the time that bytes take on a slow line; `gap_s` the
    silence that it wants before a request, where that is longer than the protocol's. `uptime` names the point that
    carries the device's own clock. `serial_baud` is the speed in bit/s of the serial line, or of that behind a gateway:
    what is polled must fit on it (`hil check`).
    """

    device_id: Annotated[int, Field(ge=0, le=255)] = 1
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 0.5
    gap_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    max_read: Annotated[int, Field(ge=1, le=125)] = 125
    max_write: Annotated[int, Field(ge=1, le=123)] = 123
    max_gap: Annotated[int, Field(ge=0, le=124)] = 8
    max_read_bits: Annotated[int, Field(ge=1, le=2000)] = 2000
    max_write_bits: Annotated[int, Field(ge=1, le=1968)] = 1968
    hole: tuple[Hole, ...] = ()
    serial_baud: Annotated[int, Field(ge=300, le=4_000_000)] | None = None
    uptime: str | None = None

    @property
    @abstractmethod
    def place(self) -> str:
        """Protocol and address, as a person reads them."""

    @property
    @abstractmethod
    def wire(self) -> tuple[object, ...]:
        """What tells this wire from another: sections in which it is the same share one."""

    @property
    def where(self) -> str:
        """Protocol, address and device."""
        return f"{self.place}, device {self.device_id}"


class ModbusTcpBus(ModbusBusSection):
    """A Modbus/TCP server and the device behind it."""

    transport: Literal["modbus_tcp"]
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 502

    @property
    def place(self) -> str:
        """Protocol, host and port."""
        return f"Modbus/TCP {self.host}:{self.port}"

    @property
    def wire(self) -> tuple[object, ...]:
        """Host and port."""
        return (self.host, self.port)


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

    @property
    def place(self) -> str:
        """Protocol, host and port."""
        return f"Modbus/TCP Security {self.host}:{self.port}"


class ModbusRtuTcpBus(ModbusTcpBus):
    """A serial line behind a converter that passes RTU frames over TCP as they are."""

    transport: Literal["modbus_rtu_tcp"]  # type: ignore[assignment]
    device_id: Annotated[int, Field(ge=1, le=247)] = 1

    @property
    def place(self) -> str:
        """Protocol, host and port."""
        return f"Modbus RTU over TCP {self.host}:{self.port}"


class ModbusRtuBus(ModbusBusSection):
    """A serial line of this machine (Modbus over serial line V1.02: even parity unless the device has another)."""

    transport: Literal["modbus_rtu"]
    serial_port: str
    serial_baud: Annotated[int, Field(ge=300, le=4_000_000)] = 19200
    parity: Literal["none", "even", "odd"] = "even"
    stop_bits: Literal[1, 2] = 1
    device_id: Annotated[int, Field(ge=1, le=247)] = 1

    @property
    def place(self) -> str:
        """Protocol, line, speed and character."""
        character = f"8{self.parity[0].upper()}{self.stop_bits}"
        return f"Modbus RTU {self.serial_port}, {self.serial_baud} bit/s {character}"

    @property
    def wire(self) -> tuple[object, ...]:
        """The serial port."""
        return (self.serial_port,)


class CanBus(Section):
    """A CAN bus reached through python-can, its frames described by a DBC file beside the rig file.

    `channel` is the interface (socketcan), the daemon's bus (socketcand), the serial port of the adapter (slcan) or any
    name (virtual, within one process). `bitrate` in bit/s is set by slcan alone: elsewhere it is the system's.
    """

    transport: Literal["socketcand", "socketcan", "slcan", "virtual"]
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 29536
    channel: str = "can0"
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] | None = None
    dbc: Path
    dbc_encoding: str = "utf-8"
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 1.0
    uptime: str | None = None

    @property
    def place(self) -> str:
        """Interface and channel."""
        daemon = f"{self.host}:{self.port}/" if self.transport == "socketcand" else ""
        return f"{self.transport} {daemon}{self.channel}"


def is_rtu(bus: ModbusBusSection) -> bool:
    """Whether requests go out in RTU frames, which carry no number that a reply could be known by."""
    return isinstance(bus, ModbusRtuBus | ModbusRtuTcpBus)


AnyBus = ModbusTcpBus | ModbusTlsBus | ModbusRtuTcpBus | ModbusRtuBus | CanBus
TRANSPORTS = (
    "modbus_tcp", "modbus_tls", "modbus_rtu_tcp", "modbus_rtu", "socketcand", "socketcan", "slcan", "virtual",
)  # fmt: skip
