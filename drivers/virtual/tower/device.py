"""A station as a Modbus/TCP device that replays its historian in accelerated time.

Input registers 0 and 1 are the station's clock, s since 1970 (uint32); from 10 on each tag takes two (float32), in
the order of the tag dictionary. Measured values run along the lines between samples, as the compression promises;
commands and states hold. A value is no number where the sample before it is not good, or where the next one is
further than any tag's regular interval.
"""

from __future__ import annotations

import asyncio
import csv
import json
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from drivers.signals import DriverError
from drivers.virtual.devices import DEVICE_ID, ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, ModbusConnection, RefusedRequest

FIRST_REGISTER = 10
LONGEST_S = 3900.0
"""Longest regular interval between two samples of an archive, s; a longer one is a gap."""
GOOD = 192
HELD = ("fan_speed_command", "fan_fault", "cell_in_service", "wind_direction")
RIG_UNIT = {
    "degC": ("degC", 1.0, 0.0),
    "degF": ("degC", 5.0 / 9.0, -160.0 / 9.0),
    "kPa": ("kPa", 1.0, 0.0),
    "psi": ("kPa", 6.894757, 0.0),
    "hPa": ("mbar", 1.0, 0.0),
    "mbar": ("mbar", 1.0, 0.0),
    "bar": ("kPa", 100.0, 0.0),
    "Pa": ("kPa", 1e-3, 0.0),
    "W": ("kW", 1e-3, 0.0),
    "hp": ("kW", 0.745699872, 0.0),
    "km/h": ("m/s", 1.0 / 3.6, 0.0),
    "gpm": ("L/s", 3.785411784 / 60.0, 0.0),
    "L/min": ("L/s", 1.0 / 60.0, 0.0),
    "m3/s": ("L/s", 1e3, 0.0),
    "t/h": ("kg/s", 1.0 / 3.6, 0.0),
    "°C": ("degC", 1.0, 0.0),
    "°F": ("degC", 5.0 / 9.0, -160.0 / 9.0),
    "kW": ("kW", 1.0, 0.0),
    "MW": ("kW", 1e3, 0.0),
    "mph": ("m/s", 0.44704, 0.0),
    "m/s": ("m/s", 1.0, 0.0),
    "m3/h": ("m3/h", 1.0, 0.0),
    "L/s": ("L/s", 1.0, 0.0),
    "kg/s": ("kg/s", 1.0, 0.0),
    "%": ("%", 1.0, 0.0),
    "Hz": ("Hz", 1.0, 0.0),
    "deg": ("1", 1.0, 0.0),
    "0/1": ("1", 1.0, 0.0),
}
"""Unit of a point by the unit of its tag, and the factor and offset from the tag's to the point's."""


class StationFolderError(DriverError):
    """A folder that is no station that can be served; the message is one sentence with the remedy."""


@dataclass(frozen=True)
class Served:
    """A tag as the device serves it: point, unit of the point, role, samples in the order of time."""

    tag: str
    point: str
    unit: str
    tag_unit: str
    role: str
    cell: str
    description: str
    scan_s: str
    time_s: NDArray[np.float64]
    value: NDArray[np.float64]
    good: NDArray[np.bool_]

    def at(self, moment_s: float) -> float:
        """Return the value at a time; NaN where it is not known."""
        k = int(np.searchsorted(self.time_s, moment_s, side="right")) - 1
        if k < 0 or not self.good[k]:
            return float("nan")
        if k + 1 == len(self.time_s) or self.time_s[k + 1] - self.time_s[k] > LONGEST_S:
            return float(self.value[k]) if moment_s - self.time_s[k] < LONGEST_S else float("nan")
        if self.role in HELD or not self.good[k + 1]:
            return float(self.value[k])
        part = (moment_s - self.time_s[k]) / (self.time_s[k + 1] - self.time_s[k])
        return float(self.value[k] + part * (self.value[k + 1] - self.value[k]))

    def measuring_range(self) -> tuple[float, float]:
        """Return a range of the instrument: that of its record, and as much again on either side."""
        seen = self.value[self.good]
        low, high = (float(seen.min()), float(seen.max())) if len(seen) else (0.0, 1.0)
        span = max(high - low, 1.0)
        return round(low - span, 2), round(high + span, 2)


def load_station(folder: Path) -> tuple[Served, ...]:
    """Return the tags of a station folder with their samples.

    Raises
    ------
    StationFolderError
        A file is missing, lacks a column, or holds no sample.
    """
    try:
        with (folder / "tags.csv").open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
        table = pq.read_table(
            folder / "raw.parquet", columns=["timestamp", "tag", "value", "quality"], read_dictionary=["tag"]
        )
    except (OSError, pa.ArrowInvalid) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise StationFolderError(
            f"{folder}: is no station to serve: {reason}; make one with hil tower simulate"
        ) from error
    lacking = [name for name in ("tag", "unit", "role") if not rows or name not in rows[0]]
    if lacking:
        raise StationFolderError(
            f"{folder / 'tags.csv'}: has no column {', '.join(lacking)}; use the station's tag dictionary"
        )
    stamp = table["timestamp"].cast(pa.timestamp("ms", tz="UTC")).cast(pa.int64()).to_numpy() * 1e-3
    value, quality = table["value"].cast(pa.float64()).to_numpy(), pc.fill_null(table["quality"], 0).to_numpy()
    names = table["tag"].combine_chunks()
    codes = {name: k for k, name in enumerate(names.dictionary.to_pylist())}
    index = names.indices.to_numpy(zero_copy_only=False)
    found = []
    for row in rows:
        unit = row["unit"]
        if unit not in RIG_UNIT:
            known = ", ".join(RIG_UNIT)
            raise StationFolderError(
                f"{folder / 'tags.csv'}: {row['tag']} is in {unit!r}; convert its samples, or remove its line: "
                f"units that can be served are {known}"
            )
        mine = np.flatnonzero(index == codes.get(row["tag"], -1))
        mine = mine[np.argsort(stamp[mine], kind="stable")]
        cell = _cell(folder / "tags.csv", row["tag"], (row.get("cell") or "").strip())
        point = f"cell{cell}_{row['role']}" if cell else row["role"]
        to, factor, offset = RIG_UNIT[unit]
        found.append(
            Served(
                row["tag"],
                point,
                to,
                unit,
                row["role"],
                cell,
                row.get("description") or "",
                row.get("scan_s") or "60",
                stamp[mine],
                value[mine] * factor + offset,
                (quality[mine] >= GOOD) & np.isfinite(value[mine]),
            )
        )
    if not any(len(one.time_s) for one in found):
        raise StationFolderError(
            f"{folder}: raw.parquet has no sample of the tags in tags.csv; use the files of one station"
        )
    return tuple(found)


def _cell(file: Path, tag: str, text: str) -> str:
    """Return a cell as a whole number, which tables of a spreadsheet may hold as `1.0`; nothing for the station."""
    try:
        number = float(text or 0.0)
        whole = int(number)
    except (ValueError, OverflowError):
        number, whole = float("nan"), 0
    if number != whole or whole < 0:
        raise StationFolderError(f"{file}: {tag} has cell {text!r}; give a whole number, or nothing for the station")
    return str(whole) if whole else ""


class Replay:
    """The station's time: it begins at `start_s` and runs `speed` times real time until `end_s`."""

    def __init__(
        self, tags: tuple[Served, ...], speed: float, start_s: float | None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        first = min(one.time_s[0] for one in tags if len(one.time_s))
        self.end_s = max(one.time_s[-1] for one in tags if len(one.time_s))
        self.start_s = float(first if start_s is None else start_s)
        self.tags, self.speed = tags, speed
        self._clock, self._zero = clock, clock()

    @property
    def now_s(self) -> float:
        """Station time, s since 1970."""
        return self.start_s + (self._clock() - self._zero) * self.speed

    def read_registers(self, table: str, first: int, count: int) -> bytes:
        """Return input registers now; raise RefusedRequest for others."""
        if table != "input":
            raise RefusedRequest(ILLEGAL_FUNCTION)
        held = self.registers()
        if 2 * (first + count) > len(held):
            raise RefusedRequest(ILLEGAL_ADDRESS)
        return held[2 * first : 2 * (first + count)]

    def read_bits(self, table: str, first: int, count: int) -> int:
        """Refuse: a station has no bits."""
        raise RefusedRequest(ILLEGAL_FUNCTION)

    def write_registers(self, first: int, values: Sequence[int]) -> None:
        """Refuse: a station is only read."""
        raise RefusedRequest(ILLEGAL_FUNCTION)

    def write_bits(self, first: int, values: Sequence[int]) -> None:
        """Refuse: a station is only read."""
        raise RefusedRequest(ILLEGAL_FUNCTION)

    def registers(self) -> bytes:
        """Return the input registers now."""
        now = self.now_s
        head = struct.pack(">I", int(now)) + bytes(2 * (FIRST_REGISTER - 2))
        return head + b"".join(struct.pack(">f", one.at(float(int(now)))) for one in self.tags)


async def serve_station(replay: Replay, host: str, port: int, ready: Callable[[int], None]) -> None:
    """Serve the station until its record ends; call `ready` with the port once it listens.

    Raises
    ------
    OSError
        The port cannot be opened.
    """
    connections: set[Any] = set()
    server = await asyncio.get_running_loop().create_server(
        lambda: ModbusConnection({DEVICE_ID: replay}, connections), host, port, reuse_address=True
    )
    try:
        ready(int(server.sockets[0].getsockname()[1]))
        await asyncio.sleep(max((replay.end_s - replay.now_s) / replay.speed, 0.0))
    finally:
        server.close()
        for connection in tuple(connections):
            connection.close()


def rig_text(tags: tuple[Served, ...], name: str, host: str, port: int, speed: float) -> str:
    """Return a rig file of the station: one bus, its clock, and a point for each tag.

    Parameters
    ----------
    tags
        Tags that the station serves.
    name
        Name of the rig.
    host, port
        Address of the station's Modbus/TCP server.
    speed
        Seconds of station time in a second; a period of the rig is a minute of station time.
    """
    about = f"Cooling-tower station, replayed at {speed:g} times real time"
    period = max(round(60.0 / speed, 3), 0.1)
    parts = [
        _section("[rig]", name=name, description=about, period_s=period),
        _section("[bus.station]", transport="modbus_tcp", host=host, port=port, uptime="station_clock"),
        _point("station_clock", 0, "uint32", "s", "Time of the station, s since 1970 (UTC)", kind="status"),
    ]
    for k, one in enumerate(tags):
        more: dict[str, Any] = {"plausible": list(one.measuring_range())}
        if one.tag_unit == "0/1":
            more = {"kind": "status"}
        about = f"{one.description}, {one.tag}"
        parts.append(_point(one.point, FIRST_REGISTER + 2 * k, "float32", one.unit, about, **more))
    return "\n".join(parts)


def _point(name: str, address: int, kind_of_number: str, unit: str, doc: str, **more: Any) -> str:
    where = {"bus": "station", "table": "input", "address": address, "type": kind_of_number}
    return _section("[[point]]", name=name, **where, unit=unit, **more, doc=doc)


def _section(heading: str, **values: Any) -> str:
    """Return a section of a TOML file; texts are quoted as in JSON, whose strings are TOML's too."""
    lines = [heading, *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


def write_dictionary(tags: tuple[Served, ...], path: Path) -> None:
    """Write the tag dictionary of a store that `hil tower collect` fills from the device: its points and their
    units."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("tag", "description", "unit", "cell", "role", "scan_s"))
        for one in tags:
            unit = one.tag_unit if one.unit == "1" else one.unit
            writer.writerow((one.point, one.description, unit, one.cell, one.role, 60))
