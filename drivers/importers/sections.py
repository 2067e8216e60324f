"""Bus sections of an imported rig file: Modbus devices over TCP or on a serial line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from drivers.importers.draft import DraftBus, ImportFileError, whole
from drivers.rig_file import AnyBus, mistake, shown

_BUS: TypeAdapter[AnyBus] = TypeAdapter(Annotated[AnyBus, Field(discriminator="transport")])
_PARITIES = {"N": "none", "E": "even", "O": "odd"}


class Sections:
    """Buses of an import, one a device, named plc, plc2, ... in the order in which they are met."""

    def __init__(self) -> None:
        self._buses: dict[tuple[object, ...], DraftBus] = {}

    def of(self, path: Path, line: int, keys: Mapping[str, Any]) -> DraftBus:
        """Return the bus of these keys; raise ImportFileError where another on its wire speaks otherwise."""
        bus = self._buses.get(tuple(keys.values()))
        for other in self._buses.values():
            if _wire(other.keys) == _wire(keys):
                for key in ("transport", "serial_baud", "parity", "stop_bits"):
                    ours, theirs = keys.get(key), other.keys.get(key)
                    if ours != theirs:
                        said = f"{key} is {ours!r} here and {theirs!r} for another device on this wire; correct one"
                        raise ImportFileError(path, line, said)
        if bus is None:
            name = f"plc{len(self._buses) + 1}" if self._buses else "plc"
            bus = self._buses[tuple(keys.values())] = DraftBus(name, dict(keys))
        return bus

    def with_points(self) -> list[DraftBus]:
        """Return the buses that have points."""
        return [bus for bus in self._buses.values() if bus.points]


def _wire(keys: Mapping[str, Any]) -> tuple[Any, ...]:
    return (keys["serial_port"],) if "serial_port" in keys else (keys["host"], keys["port"])


def on_line(path: Path, line: int, device: int) -> int:
    """Return the number of a device on a serial line; raise ImportFileError where none can have it."""
    if not 1 <= device <= 247:
        raise ImportFileError(path, line, f"device {device} cannot be read on a serial line; give its number, 1 to 247")
    return device


def tcp(path: Path, line: int, host: str, port: int, device: int, *, rtu: bool = False) -> dict[str, Any]:
    """Return the keys of a Modbus/TCP server, or with `rtu` of a converter that passes on frames of a serial line.

    Raises ImportFileError where a rig file refuses one of them.
    """
    if rtu:
        on_line(path, line, device)
    transport = "modbus_rtu_tcp" if rtu else "modbus_tcp"
    return _accepted(path, line, {"transport": transport, "host": host, "port": port, "device_id": device})


def serial(
    path: Path, line: int, port: str, device: int, *, baud: Any, parity: Any, stop_bits: Any, data_bits: Any
) -> dict[str, Any]:
    """Return the keys of a serial line; values that the source lacks are None. Raise ImportFileError."""
    on_line(path, line, device)
    if baud is None:
        raise ImportFileError(path, line, f"the serial line {port} has no speed; add what the device is set to")
    if data_bits is not None and whole(path, line, "data bits", data_bits, 5, 8) != 8:
        raise ImportFileError(
            path, line, f"{shown(data_bits)} data bits cannot carry RTU frames; the device must have 8"
        )
    keys: dict[str, Any] = {"transport": "modbus_rtu", "serial_port": port}
    keys["serial_baud"] = whole(path, line, "speed in bit/s", baud, 300, 4_000_000)
    if parity is not None:
        if not isinstance(parity, str) or parity not in _PARITIES:
            raise ImportFileError(path, line, f"parity {shown(parity)} is not known; use {', '.join(_PARITIES)}")
        keys["parity"] = _PARITIES[parity]
    if stop_bits is not None:
        keys["stop_bits"] = whole(path, line, "stop bits", stop_bits, 1, 2)
    return _accepted(path, line, keys | {"device_id": device})


def _accepted(path: Path, line: int, keys: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of a bus; raise ImportFileError with the rig file's own sentence where it refuses a value."""
    try:
        _BUS.validate_python(keys)
    except ValidationError as error:
        item = error.errors()[0]
        raise ImportFileError(path, line, f"{item['loc'][-1]}: {mistake(item)}") from None
    return keys
