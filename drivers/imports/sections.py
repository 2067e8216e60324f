"""Bus sections of an imported rig file: how a Modbus device is reached, over TCP or on a serial line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.imports.draft import DraftBus, ImportFileError, whole

_PARITIES = {"N": "none", "E": "even", "O": "odd"}


class Sections:
    """The buses of an import, one a device, named plc, plc2, ... in the order in which they are met."""

    def __init__(self) -> None:
        self._buses: dict[tuple[object, ...], DraftBus] = {}

    def of(self, keys: Mapping[str, Any]) -> DraftBus:
        """The bus of these keys."""
        bus = self._buses.get(tuple(keys.values()))
        if bus is None:
            name = f"plc{len(self._buses) + 1}" if self._buses else "plc"
            bus = self._buses[tuple(keys.values())] = DraftBus(name, dict(keys))
        return bus

    def with_points(self) -> list[DraftBus]:
        """Those that have points."""
        return [bus for bus in self._buses.values() if bus.points]


def tcp(host: str, port: int, device: int, *, rtu: bool = False) -> dict[str, Any]:
    """A Modbus/TCP server, or with `rtu` a converter that passes the frames of a serial line on as they are."""
    return {"transport": "modbus_rtu_tcp" if rtu else "modbus_tcp", "host": host, "port": port, "device_id": device}


def serial(
    path: Path, line: int, port: str, device: int, *, baud: Any, parity: Any, stop_bits: Any, data_bits: Any
) -> dict[str, Any]:
    """A serial line; None for what the source does not say. Raises ImportFileError."""
    if baud is None:
        raise ImportFileError(path, line, f"the serial line {port} has no speed; add what the device is set to")
    if data_bits is not None and whole(path, line, "data bits", data_bits, 5, 8) != 8:
        raise ImportFileError(path, line, f"{data_bits} data bits cannot carry RTU frames; the device must have 8")
    keys: dict[str, Any] = {"transport": "modbus_rtu", "serial_port": port}
    keys["serial_baud"] = whole(path, line, "speed in bit/s", baud, 300, 4_000_000)
    if parity is not None:
        if parity not in _PARITIES:
            raise ImportFileError(path, line, f"parity {parity!r} is not known; use {', '.join(_PARITIES)}")
        keys["parity"] = _PARITIES[parity]
    if stop_bits is not None:
        keys["stop_bits"] = whole(path, line, "stop bits", stop_bits, 1, 2)
    return keys | {"device_id": device}
