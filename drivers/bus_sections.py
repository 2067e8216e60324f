"""Sections of a rig file that say how a bus is reached, `[bus.NAME]`: one class a transport, validated."""

from __future__ import annotations

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


class ModbusTcpBus(Section):
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


class CanBus(Section):
    """A CAN bus reached through python-can, its frames described by a DBC file beside the rig file."""

    transport: Literal["socketcand", "socketcan"]
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] = 29536
    channel: str = "can0"
    dbc: Path
    dbc_encoding: str = "utf-8"
    timeout_s: Annotated[float, Field(gt=0, le=10)] = 1.0
    uptime: str | None = None
