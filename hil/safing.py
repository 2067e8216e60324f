"""Making the rig safe: the one way in which every run ends, and the one place that decides whether it worked."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from drivers.points import DriverError
from drivers.rig import RigConnection

WRITE_DEADLINE_S = 30.0
HURRIED_WRITE_DEADLINE_S = 5.0
RETRY_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class Safed:
    """`written`: the rig holds the safe values, read back from it. `followed`: the measured values got there."""

    written: bool
    followed: bool
    problem: str


async def make_safe(
    connection: RigConnection,
    safe_values: dict[str, float],
    *,
    heartbeat: Callable[[], dict[str, float]],
    advance: Callable[[], Awaitable[None]],
    period_s: float,
    hurried: Callable[[], bool],
) -> Safed:
    """Write `safe_values` in their order, read them back, and wait until the measured values follow.

    A lost link is retried for `WRITE_DEADLINE_S` of wall time. `advance` lets one period of rig time pass. When
    `hurried()` turns true the waits are cut short; the writing and its read-back never are. Raises nothing.
    """
    began = time.monotonic()
    while True:
        problem = await write_safe(connection, safe_values)
        if not problem:
            break
        if time.monotonic() - began > (HURRIED_WRITE_DEADLINE_S if hurried() else WRITE_DEADLINE_S):
            return Safed(False, False, problem)
        await asyncio.sleep(RETRY_EVERY_S)
    waits = [connection.rig.get(name).readback_within_s for name in safe_values]
    for _ in range(math.ceil(max(waits, default=0.0) / period_s)):
        try:
            problem = await _not_followed(connection, safe_values)
            if not problem or hurried():
                break
            await connection.write(heartbeat())
            await advance()
        except DriverError as error:
            problem = str(error)
            await asyncio.sleep(RETRY_EVERY_S)
    return Safed(True, not problem, problem)


async def write_safe(connection: RigConnection, safe_values: dict[str, float]) -> str:
    """Write in order and read back, once; what went wrong, or an empty string."""
    try:
        last = len(safe_values)
        held: dict[str, float] = {}
        for number, (name, value) in enumerate(safe_values.items(), 1):
            if number < last:
                await connection.write({name: value})
            else:
                held = await connection.write_and_read_back({name: value}, tuple(safe_values))
    except DriverError as error:
        return str(error)
    wrong = [
        f"{name} holds {held[name]:g} instead of {value:g}"
        for name, value in safe_values.items()
        if abs(held[name] - value) > abs(connection.rig.get(name).scale)
    ]
    return "; ".join(wrong)


async def _not_followed(connection: RigConnection, safe_values: dict[str, float]) -> str:
    """Which measured value is still away from its safe value, or an empty string; raises DriverError."""
    snapshot = await connection.read()
    if snapshot.faults:
        raise DriverError(snapshot.faults[0])
    measured = dict(zip((point.name for point in connection.points), snapshot.values, strict=True))
    for name, value in safe_values.items():
        point = connection.rig.get(name)
        if point.readback is None:
            continue
        now = measured.get(point.readback, math.nan)
        if not abs(now - value) <= point.readback_tolerance:
            return f"{point.readback} reads {now:.1f} {point.unit} where {value:g} {point.unit} is safe"
    return ""
