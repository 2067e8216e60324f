"""Planning of requests: registers and bits of points joined to blocks. Pure, no I/O.

Requests are made of whole points: a value is never split, and a hole that the rig file declares never crossed. Limits
are the protocol's (Modbus application protocol V1.1b3, 6.1 to 6.4, 6.11 and 6.12) or the device's, if narrower.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Protocol

from drivers.rig_file import Point

BIT_TABLES = ("coil", "discrete")
READ_CODE = {"coil": 1, "discrete": 2, "holding": 3, "input": 4}
MAX_READ = 125
MAX_WRITE = 123
MAX_READ_WRITE = 121
"""Registers that function 23 may write (6.17); it may read as many as function 3."""
MAX_READ_BITS = 2000
MAX_WRITE_BITS = 1968
AGAIN_AFTER_S = 30.0
"""Time after which a refused value is asked for again, s."""
_BITS_PER_REGISTER = 16


class AddressHole(Protocol):
    """Addresses `first` to `last` of `table` that the device lacks: it refuses a request that touches one."""

    @property
    def table(self) -> str: ...
    @property
    def first(self) -> int: ...
    @property
    def last(self) -> int: ...


@dataclass(frozen=True, slots=True, eq=False)  # compared by identity: comparing and hashing points takes long
class Block:
    """One request: `count` registers (or bits) of `table` from `address`, holding `points` in address order.

    With `multiple` a single value is written by the functions for several, 15 and 16.
    """

    table: str
    address: int
    count: int
    points: tuple[Point, ...]
    multiple: bool = False

    @property
    def unused(self) -> int:
        """Number of registers or bits that are read and belong to no point."""
        return self.count - len({a for p in self.points for a in range(_start(p), _end(p))})

    @property
    def read_code(self) -> int:
        """Function code that reads this block."""
        return READ_CODE[self.table]

    @property
    def write_code(self) -> int:
        """Function code that writes this block: 5 and 6 for a single bit or register, 15 and 16 for all others.

        A value of several registers goes in one request of function 16: in two of function 6 a device would act on
        half of it.
        """
        if self.table in BIT_TABLES:
            return 5 if self.count == 1 and not self.multiple else 15
        return 6 if self.count == 1 and not self.multiple else 16

    @property
    def read_bytes(self) -> tuple[int, int]:
        """Bytes of the PDU of a read request and of its reply (6.1 to 6.4)."""
        data = -(-self.count // 8) if self.table in BIT_TABLES else 2 * self.count
        return 5, 2 + data

    def __str__(self) -> str:
        last = self.address + self.count - 1
        return f"{self.table} {self.address}" + (f" to {last}" if last > self.address else "")


def plan_reads(
    points: Iterable[Point],
    *,
    max_read: int = MAX_READ,
    max_gap: int = 8,
    max_read_bits: int = MAX_READ_BITS,
    holes: Sequence[AddressHole] = (),
) -> list[Block]:
    """Return the fewest read requests for `points`.

    Parameters
    ----------
    points
        Points of one device.
    max_read, max_read_bits
        Most registers, and most bits, of one request.
    max_gap
        Most unused registers (16 bits each) in a gap that a request may read along.
    holes
        Addresses that the device does not have; no request touches them.
    """
    return _plan(points, max_read, max_read_bits, max_gap, holes)


def plan_writes(
    points: Iterable[Point],
    *,
    max_write: int = MAX_WRITE,
    max_write_bits: int = MAX_WRITE_BITS,
    multiple: bool = False,
) -> list[Block]:
    """Return the fewest write requests for `points`; only adjacent registers are joined, so none is written unasked.

    `multiple` is True for a device that has functions 15 and 16 alone.
    """
    blocks = _plan(points, max_write, max_write_bits, 0, ())
    return [replace(block, multiple=True) for block in blocks] if multiple else blocks


def _start(point: Point) -> int:
    return point.address or 0


def _end(point: Point) -> int:
    return _start(point) + point.width


def _plan(
    points: Iterable[Point], registers: int, bits: int, max_gap: int, holes: Sequence[AddressHole]
) -> list[Block]:
    placed = [point for point in points if point.table is not None and point.address is not None]
    placed.sort(key=lambda point: (str(point.table), _start(point), point.width))
    blocks: list[Block] = []
    for table, group in groupby(placed, key=lambda point: str(point.table)):
        is_bits = table in BIT_TABLES
        most, gap = (bits, max_gap * _BITS_PER_REGISTER) if is_bits else (registers, max_gap)
        absent = [hole for hole in holes if hole.table == table]
        run: list[Point] = []
        end = 0
        for point in group:
            crossed = any(end <= hole.last and hole.first < _start(point) for hole in absent)
            if run and (_start(point) - end > gap or max(_end(point), end) - _start(run[0]) > most or crossed):
                blocks.append(_block(table, run))
                run = []
            end = max(end, _end(point)) if run else _end(point)
            run.append(point)
        if run:
            blocks.append(_block(table, run))
    return blocks


def _block(table: str, run: Sequence[Point]) -> Block:
    first, last = _start(run[0]), max(_end(point) for point in run)
    return Block(table, first, last - first, tuple(run))


def split(block: Block) -> list[Block]:
    """Return the parts in which a refused block is read: split at its gaps where it has any, else in halves.

    One part only where the block cannot be split: a single value, or bit fields of the same register.
    """
    groups: list[list[Point]] = []
    for point in block.points:
        if groups and _start(point) < max(_end(other) for other in groups[-1]):
            groups[-1].append(point)
        else:
            groups.append([point])
    touching: list[list[Point]] = []
    for group in groups:
        if touching and _start(group[0]) == max(_end(other) for other in touching[-1]):
            touching[-1].extend(group)
        else:
            touching.append(list(group))
    if len(touching) == 1 and len(groups) > 1:
        half = len(groups) // 2
        touching = [[p for g in part for p in g] for part in (groups[:half], groups[half:])]
    return [_block(block.table, part) for part in touching]


class ReadPlan:
    """Read plan of one device for one run: a refused block is read in parts from then on.

    `blocks` are the reads of a tick; `refused` are blocks of single values that the device does not read, with the time
    of the refusal in s. They are read again after `again_after_s`, for a device that was only starting up. A single
    value whose refusal may pass stays in `blocks`, and the whole plan is tried again after that time.
    """

    def __init__(self, blocks: Iterable[Block], *, again_after_s: float = AGAIN_AFTER_S) -> None:
        self.planned = tuple(blocks)
        self.blocks = list(self.planned)
        self.refused: dict[Block, float] = {}
        self._again_after_s = again_after_s
        self._passing_since: float | None = None

    def refuse(self, block: Block, now_s: float, *, passing: bool = False) -> list[Block]:
        """Replace a block that the device refused by its parts; return these, none where the block has only one.

        `passing` is True for a refusal that may pass.
        """
        if block not in self.blocks:  # the plan was forgotten since the request
            return []
        if passing and self._passing_since is None:
            self._passing_since = now_s
        parts = split(block)
        at = self.blocks.index(block)
        if len(parts) == 1:
            if not passing:
                self.refused[block] = now_s
                del self.blocks[at]
            return []
        self.blocks[at : at + 1] = parts
        return parts

    def due(self, now_s: float) -> list[Block]:
        """Return the blocks to read on a tick at `now_s`, with refused ones that are due again."""
        if self._passing_since is not None and now_s - self._passing_since >= self._again_after_s:
            self.forget()
        for block in [b for b, since in self.refused.items() if now_s - since >= self._again_after_s]:
            del self.refused[block]
            self.blocks.append(block)
        return list(self.blocks)

    def forget(self) -> None:
        """Plan as at the beginning: after a reconnection another device may answer."""
        self.blocks = list(self.planned)
        self.refused.clear()
        self._passing_since = None
