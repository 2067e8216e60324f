"""Registers and bits of one Modbus device, as the points of a rig file place and encode them. No I/O.

A table reaches from its first point to its last one; the device lacks all other addresses, and the holes that the rig
file declares. Registers between points read 0, and only those of writable points can be written.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence

from drivers.rig_file import Hole, ModbusBusSection, Point
from drivers.signals import UNSIGNED, WIDTH, decode, encode, encode_text, raw_bounds
from drivers.virtual.devices import (
    ILLEGAL_ADDRESS,
    ILLEGAL_FUNCTION,
    ILLEGAL_VALUE,
    BitTable,
    RefusedRequest,
    RegisterTable,
)

_FLOAT_ROOM = 1.0 - 1e-7
"""Share of a float's range that is used: the end itself may round to infinity."""


class _Cells:
    """Registers or bits of one table, from address `first` on."""

    def __init__(self, points: Sequence[Point], holes: Sequence[Hole]) -> None:
        starts = [point.address or 0 for point in points]
        self.first = min(starts)
        self.held = [0] * (max(at + point.width for at, point in zip(starts, points, strict=True)) - self.first)
        self._holes = holes
        self._writable = {
            at + k for at, p in zip(starts, points, strict=True) if p.access != "r" for k in range(p.width)
        }

    def span(self, first: int, count: int, *, write: bool = False) -> slice:
        """Return where addresses are held; raise RefusedRequest where the device lacks one, or it cannot be written."""
        last = first + count - 1
        absent = first < self.first or last >= self.first + len(self.held)
        if absent or any(first <= hole.last and hole.first <= last for hole in self._holes):
            raise RefusedRequest(ILLEGAL_ADDRESS)
        if write and not all(address in self._writable for address in range(first, last + 1)):
            raise RefusedRequest(ILLEGAL_ADDRESS)
        return slice(first - self.first, last + 1 - self.first)


class DeviceMemory:
    """Memory of one device of a rig file; `accepts` is called after each write, which it may refuse."""

    def __init__(self, bus: ModbusBusSection, points: Sequence[Point]) -> None:
        self.accepts: Callable[[], bool] = lambda: True
        self._tables = {
            table: _Cells(of_table, [hole for hole in bus.hole if hole.table == table])
            for table in ("coil", "discrete", "holding", "input")
            if (of_table := [point for point in points if point.table == table])
        }
        self._fields: dict[tuple[object, ...], int] = {}
        """Whole numbers of registers that several points have bits of."""

    # Interface of `devices.Memory`.

    def read_registers(self, table: RegisterTable, first: int, count: int) -> bytes:
        """Return registers, big-endian; raise RefusedRequest."""
        cells = self._cells(table)
        return struct.pack(f">{count}H", *cells.held[cells.span(first, count)])

    def read_bits(self, table: BitTable, first: int, count: int) -> int:
        """Return bits, the first one as bit 0; raise RefusedRequest."""
        cells = self._cells(table)
        return sum(bit << at for at, bit in enumerate(cells.held[cells.span(first, count)]))

    def write_registers(self, first: int, values: Sequence[int]) -> None:
        """Write holding registers; raise RefusedRequest, and write nothing."""
        self._write("holding", first, values)

    def write_bits(self, first: int, values: Sequence[int]) -> None:
        """Write coils; raise RefusedRequest, and write nothing."""
        self._write("coil", first, values)

    def _cells(self, table: str) -> _Cells:
        if table not in self._tables:
            raise RefusedRequest(ILLEGAL_FUNCTION)
        return self._tables[table]

    def _write(self, table: str, first: int, values: Sequence[int]) -> None:
        cells = self._cells(table)
        span = cells.span(first, len(values), write=True)
        before = cells.held[span]
        cells.held[span] = list(values)
        if not self.accepts():
            cells.held[span] = before
            raise RefusedRequest(ILLEGAL_VALUE)

    # Values of points.

    def value(self, point: Point) -> float:
        """Return the value that a point holds, in its unit."""
        registers = self._held(point)
        return decode(registers, point.type, point.order) * point.scale + point.offset

    def put(self, point: Point, value: float) -> None:
        """Hold `value`, in the point's unit; one beyond the type's range becomes its end, and no sentinel is held."""
        raw = (value - point.offset) / point.scale
        low, high = raw_bounds(point.type, point.bits)
        if point.type.startswith("float"):
            self._hold(point, encode(min(max(raw, low * _FLOAT_ROOM), high * _FLOAT_ROOM), point.type, point.order))
            return
        least, most = whole_bounds(point)
        whole = min(max(round(raw) if math.isfinite(raw) else least, least), most)
        self._put_whole(point, _beside_sentinels(point, whole, most))

    def put_count(self, point: Point, value: float) -> None:
        """Hold a counter or a clock, in the point's unit: it begins again at 0 behind the end of its type."""
        raw = math.ceil((value - point.offset) / point.scale - 1e-9)
        if point.type.startswith("float"):
            self.put(point, value)
        else:
            self._put_whole(point, raw % (whole_bounds(point)[1] + 1))

    def put_text(self, point: Point, text: str) -> None:
        """Hold a text; raise CodecError where it does not fit."""
        assert point.length is not None
        self._hold(point, encode_text(text, point.length, point.order))

    def _put_whole(self, point: Point, whole: int) -> None:
        if point.bits is not None:
            low, high = point.bits
            key = (point.table, point.address, point.type, point.order)
            mask = (1 << (high - low + 1)) - 1
            whole = self._fields.get(key, 0) & ~(mask << low) | whole << low
            self._fields[key] = whole
        self._hold(point, encode(whole, point.type, point.order))

    def _hold(self, point: Point, registers: Sequence[int]) -> None:
        cells = self._tables[str(point.table)]
        at = (point.address or 0) - cells.first
        cells.held[at : at + point.width] = registers

    def _held(self, point: Point) -> list[int]:
        cells = self._tables[str(point.table)]
        at = (point.address or 0) - cells.first
        return cells.held[at : at + point.width]


def whole_bounds(point: Point) -> tuple[int, int]:
    """Return the least and the greatest raw number of a point of a whole type, exact also for 64 bits."""
    if point.bits is not None:
        return 0, (1 << (point.bits[1] - point.bits[0] + 1)) - 1
    if point.type == "bool":
        return 0, 1
    size = 16 * WIDTH[point.type]
    return (0, (1 << size) - 1) if point.type in UNSIGNED else (-(1 << (size - 1)), (1 << (size - 1)) - 1)


def _beside_sentinels(point: Point, whole: int, most: int) -> int:
    """Return the raw number, or the next one to it that does not mean a faulty sensor."""

    def means_fault(raw: int) -> bool:
        value = raw * point.scale + point.offset
        return raw in point.sentinels or any(abs(value - s) <= near for s, near in point.scaled_sentinels)

    step = 1 if whole < most else -1
    while means_fault(whole) and 0 <= whole + step <= most:
        whole += step
    return whole
