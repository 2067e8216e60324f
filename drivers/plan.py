"""Which registers to ask for in one request: pure planning, no I/O.

Requests are made of whole points, never split a value, and stay within the protocol's limits of 125 registers read
and 123 written (Modbus application protocol V1.1b3, 6.3, 6.4 and 6.12).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby

from drivers.rigfile import Point


@dataclass(frozen=True, slots=True)
class Block:
    """One request: `count` registers of `table` from `address`, holding `points` in address order."""

    table: str
    address: int
    count: int
    points: tuple[Point, ...]


def plan_reads(points: Iterable[Point], *, max_read: int = 125, max_gap: int = 8) -> list[Block]:
    """Fewest read requests for `points`, joining neighbours over holes of at most `max_gap` registers."""
    return _plan(points, max_count=max_read, max_gap=max_gap)


def plan_writes(points: Iterable[Point], *, max_write: int = 123) -> list[Block]:
    """Fewest write requests for `points`: only registers that touch are joined, so none is written unasked."""
    return _plan(points, max_count=max_write, max_gap=0)


def _plan(points: Iterable[Point], *, max_count: int, max_gap: int) -> list[Block]:
    placed = [point for point in points if point.table is not None and point.address is not None]
    placed.sort(key=lambda point: (str(point.table), point.address or 0))
    blocks: list[Block] = []
    for table, group in groupby(placed, key=lambda point: str(point.table)):
        run: list[Point] = []
        for point in group:
            start = point.address or 0
            if run:
                first, last = run[0].address or 0, (run[-1].address or 0) + run[-1].width
                if start - last > max_gap or start + point.width - first > max_count:
                    blocks.append(_block(table, run))
                    run = []
            run.append(point)
        if run:
            blocks.append(_block(table, run))
    return blocks


def _block(table: str, run: list[Point]) -> Block:
    first, last = run[0].address or 0, (run[-1].address or 0) + run[-1].width
    return Block(table, first, last - first, tuple(run))
