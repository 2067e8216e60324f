"""Bus sections of a rig file, `[bus.NAME]`: transport, address and limits. One validated class a transport."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from drivers.rig_file.can_ids import EXTENDED_BITS, HIGHEST_PGN, STANDARD_BITS, IdMatch, by_id, by_pgn, is_pdu1
from drivers.rig_file.plain_values import checked_host, refuse_quoted_numbers


class Section(BaseModel):
    """Section of a rig file: unknown keys are mistakes, and so are infinite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _numbers_are_not_quoted(cls, data: Any) -> Any:
        refuse_quoted_numbers(cls, data)
        return data


Table = Literal["coil", "discrete", "holding", "input"]


class Hole(Section):
    """Addresses `first` to `last` of a table that the device lacks; no request crosses them."""

    table: Table
    first: Annotated[int, Field(ge=0, le=65535)]
    last: Annotated[int, Field(ge=0, le=65535)]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.last < self.first:
            raise ValueError(f"a hole from {self.first} to {self.last} is none; give first and last in this order")
        return self


class ModbusBusSection(Section, ABC):
    """Modbus device on any transport. Sections of the same line, or the same host and port, share that wire.

    `timeout_s` is the longest time to an answer, without the time that bytes take on a slow line. `gap_s` is the
    silence that the device needs before a request, where that is longer than the protocol's. `connect_delay_s` is the
    time after connecting in which no request is sent, since the device would lose it. `uptime` names the point that
    carries the device's own clock. `serial_baud` is the speed in bit/s of the serial line, or of that behind a gateway:
    all polling must fit on it (`hil check`). `read_write` declares function 23: a write and its read-back are then one
    request. `write_multiple` declares a device without functions 5 and 6: single values too are written with 15 and 16.
    """

    device_id: Annotated[int, Field(ge=0, le=255)] = 1
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 0.5
    gap_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    connect_delay_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    max_read: Annotated[int, Field(ge=1, le=125)] = 125
    max_write: Annotated[int, Field(ge=1, le=123)] = 123
    max_gap: Annotated[int, Field(ge=0, le=124)] = 8
    max_read_bits: Annotated[int, Field(ge=1, le=2000)] = 2000
    max_write_bits: Annotated[int, Field(ge=1, le=1968)] = 1968
    hole: tuple[Hole, ...] = ()
    serial_baud: Annotated[int, Field(ge=300, le=4_000_000)] | None = None
    read_write: bool = False
    write_multiple: bool = False
    uptime: str | None = None

    @property
    @abstractmethod
    def place(self) -> str:
        """Protocol and address as text for messages."""

    @property
    def where(self) -> str:
        """Protocol, address and device number as text for messages."""
        return f"{self.place}, device {self.device_id}"


class ModbusTcpBus(ModbusBusSection):
    """Modbus/TCP server and the device behind it.

    `transaction` is `zero` for a device that answers every request with transaction 0: read as a serial line is.
    `frame_length` is `ignored` for one whose headers announce another length than its replies have: these then are as
    long as their function and byte count say.
    """

    transport: Literal["modbus_tcp"]
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 502
    transaction: Literal["checked", "zero"] = "checked"
    frame_length: Literal["checked", "ignored"] = "checked"

    @field_validator("host")
    @classmethod
    def _is_host(cls, host: str) -> str:
        return checked_host(host)

    @property
    def place(self) -> str:
        """Protocol, host and port."""
        return f"Modbus/TCP {self.host}:{self.port}"


class ModbusTlsBus(ModbusTcpBus):
    """Modbus/TCP server over TLS with certificates both ways (Modbus/TCP Security protocol specification, v21).

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
    """Serial line behind a converter that passes RTU frames over TCP as they are."""

    transport: Literal["modbus_rtu_tcp"]  # type: ignore[assignment]
    device_id: Annotated[int, Field(ge=1, le=247)] = 1

    @model_validator(mode="after")
    def _no_transaction(self) -> Self:
        for key in ("transaction", "frame_length"):
            if key in self.model_fields_set:
                raise ValueError(f"RTU frames have no {key}; take it out, or use transport = 'modbus_tcp'")
        return self

    @property
    def place(self) -> str:
        """Protocol, host and port."""
        return f"Modbus RTU over TCP {self.host}:{self.port}"


class ModbusRtuBus(ModbusBusSection):
    """Serial line of this machine (Modbus over serial line V1.02: even parity unless the device has another)."""

    transport: Literal["modbus_rtu"]
    serial_port: str
    serial_baud: Annotated[int, Field(ge=300, le=4_000_000)] = 19200
    parity: Literal["none", "even", "odd"] = "even"
    stop_bits: Literal[1, 2] = 1
    device_id: Annotated[int, Field(ge=1, le=247)] = 1

    @property
    def place(self) -> str:
        """Protocol, line, speed and character format as text for messages."""
        character = f"8{self.parity[0].upper()}{self.stop_bits}"
        return f"Modbus RTU {self.serial_port}, {self.serial_baud} bit/s {character}"


class CanMessage(Section):
    """Frames of a message that the DBC does not identify: an identifier with a mask, or a PGN of J1939.

    `name` is its name in points; its layout is that of `dbc_message`, by default the DBC's message of the same name.
    Bits that are 0 in `mask` may have any value. A PGN matches at any priority, from `source` and to `destination`.
    """

    name: str
    dbc_message: str | None = None
    id: Annotated[int, Field(ge=0, le=EXTENDED_BITS)] | None = None
    mask: Annotated[int, Field(ge=0, le=EXTENDED_BITS)] | None = None
    extended: bool | None = None
    pgn: Annotated[int, Field(ge=0, le=HIGHEST_PGN)] | None = None
    source: Annotated[int, Field(ge=0, le=253)] | None = None
    destination: Annotated[int, Field(ge=0, le=255)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        mistake = self._mistaken_id() if self.pgn is None else self._mistaken_pgn(self.pgn)
        if mistake is not None:
            raise ValueError(f"message {self.name}: {mistake}")
        return self

    def _mistaken_id(self) -> str | None:
        if self.id is None:
            return "needs an id (with extended, and perhaps a mask) or a pgn; add one"
        if self.source is not None or self.destination is not None:
            return "source and destination go with a pgn; give pgn instead of id"
        if self.extended is None:
            return "an id has 11 or 29 bits; say extended = false or true"
        if not self.extended and max(self.id, self.mask or 0) > STANDARD_BITS:
            return f"an id or a mask beyond 0x{STANDARD_BITS:X} has 29 bits; correct it or give extended = true"
        return None

    def _mistaken_pgn(self, pgn: int) -> str | None:
        if self.id is not None or self.mask is not None or self.extended is not None:
            return "a pgn stands for id, mask and extended; take these or the pgn out"
        if is_pdu1(pgn) and pgn & 0xFF:
            return f"PGN 0x{pgn:04X} is sent to a destination; end it with 00 and give destination = 0x{pgn & 0xFF:02X}"
        if self.destination is not None and not is_pdu1(pgn):
            return f"PGN 0x{pgn:04X} is sent to all; take destination out"
        return None

    @property
    def match(self) -> IdMatch:
        """Identifiers of this message's frames."""
        if self.pgn is not None:
            return by_pgn(self.pgn, self.source, self.destination)
        return by_id(self.id or 0, bool(self.extended), self.mask)


class CanBus(Section):
    """CAN bus reached through python-can, its frames described by a DBC file.

    `channel` is the interface (socketcan), the daemon's bus (socketcand), the serial port of the adapter (slcan) or any
    name (virtual, within one process). `bitrate` in bit/s is set by slcan alone: elsewhere it is the system's.
    `message` identifies the frames of messages for which the DBC does not suffice.
    """

    transport: Literal["socketcand", "socketcan", "slcan", "virtual"]
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 29536
    channel: str = "can0"
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] | None = None
    dbc: Path
    dbc_encoding: str = "utf-8"
    message: tuple[CanMessage, ...] = ()

    @field_validator("host")
    @classmethod
    def _is_host(cls, host: str) -> str:
        return checked_host(host)

    timeout_s: Annotated[float, Field(gt=0, le=10)] = 1.0
    uptime: str | None = None

    @property
    def place(self) -> str:
        """Interface and channel as text for messages."""
        daemon = f"{self.host}:{self.port}/" if self.transport == "socketcand" else ""
        return f"{self.transport} {daemon}{self.channel}"


def is_rtu(bus: ModbusBusSection) -> bool:
    """Return True where requests go out in RTU frames, which carry no transaction number."""
    return isinstance(bus, ModbusRtuBus | ModbusRtuTcpBus)


def is_numbered(bus: ModbusBusSection) -> bool:
    """Return True where a reply carries the transaction number of its request."""
    return isinstance(bus, ModbusTcpBus) and not is_rtu(bus) and bus.transaction == "checked"


AnyBus = ModbusTcpBus | ModbusTlsBus | ModbusRtuTcpBus | ModbusRtuBus | CanBus
TRANSPORTS = (
    "modbus_tcp",
    "modbus_tls",
    "modbus_rtu_tcp",
    "modbus_rtu",
    "socketcand",
    "socketcan",
    "slcan",
    "virtual",
)
