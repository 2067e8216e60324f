"""Making the rig safe: the one way in which every run ends, and the one place that decides whether it worked.

Safe means read back from the rig *and* measured: while a heater's meter reads more than its limit (`heaters`) the
rig is not safe, and while the meter does not come down it gets no heartbeat, so that its own watchdog can act.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from drivers.points import DriverError, Snapshot
from drivers.rig import RigConnection
from hil.run.outputs.heaters import Descent, good_readings, not_cold, safe_limits
from hil.run.outputs.setpoints import count_tolerance

WRITE_DEADLINE_S = 30.0
HURRIED_WRITE_DEADLINE_S = 5.0
RETRY_EVERY_S = 0.1


@dataclass(frozen=True, slots=True)
class Safed:
    """Result of making safe. `written`: the rig holds the safe values, read back from it. `followed`: the measured
    values got there. `hot`: which heater's meter still reads more than is safe, as a sentence, or empty."""

    written: bool
    followed: bool
    problem: str
    hot: str = ""

    @property
    def safe(self) -> bool:
        """Return whether the safe values are read back and no meter contradicts them."""
        return self.written and not self.hot


async def make_safe(
    connection: RigConnection,
    safe_values: dict[str, float],
    *,
    heartbeat: Callable[[], dict[str, float]],
    advance: Callable[[], Awaitable[None]],
    period_s: float,
    hurried: Callable[[], bool],
    progress: Callable[[], None] = lambda: None,
    failed: Callable[[], bool] = lambda: False,
) -> Safed:
    """Write `safe_values` in their order, read them back, and wait until the measured values follow.

    A lost link is retried for `WRITE_DEADLINE_S` of wall time. `advance` lets one period of rig time pass. When
    `hurried()` turns true the waits are cut short; the writing and its read-back never are. `progress` is called
    before each attempt, `failed` after each that failed: it returns whether somebody else has made the rig safe.
    Raises nothing.
    """
    began = time.monotonic()
    while True:
        progress()
        problem = await write_safe(connection, safe_values)
        if not problem:
            break
        if failed():
            return Safed(True, True, "")
        if time.monotonic() - began > (HURRIED_WRITE_DEADLINE_S if hurried() else WRITE_DEADLINE_S):
            return Safed(False, False, problem)
        await asyncio.sleep(RETRY_EVERY_S)
    waits = [connection.rig.get(name).readback_within_s for name in safe_values]
    limits, held_s = safe_limits(connection.rig), time.monotonic()
    hot = "no meter was read" if limits else ""
    descent = Descent(connection.rig, limits, period_s)
    for number in range(math.ceil(max(waits, default=0.0) / period_s)):
        progress()
        try:
            snapshot = await connection.read()
            problem = _not_followed(connection, snapshot, safe_values)
            readings = good_readings(connection.points, snapshot)
            hot = not_cold(connection.rig, limits, readings)
            problem = hot or problem
            if not problem or hurried():
                break
            if not descent.stays(readings, number * period_s):
                await connection.write(heartbeat())
            else:  # another master may have written since
                problem = await write_safe(connection, safe_values) or problem
            await advance()
        except DriverError as error:
            problem = str(error)
            if hurried() or time.monotonic() - held_s > max(waits) + WRITE_DEADLINE_S:
                break
            await asyncio.sleep(RETRY_EVERY_S)
    again = await write_safe(connection, safe_values)  # the last word, whoever has written meanwhile
    return Safed(not again, not (problem or again), again or problem, hot)


async def write_safe(connection: RigConnection, safe_values: dict[str, float]) -> str:
    """Write in order and read back, once; return what went wrong, or an empty string.

    Each output is tried whatever became of the others: a pump that refuses must not keep the heater on.
    """
    refused: dict[str, str] = {}
    held: dict[str, float] = {}
    last = len(safe_values)
    for number, (name, value) in enumerate(safe_values.items(), 1):
        try:
            if number < last or refused:
                await connection.write({name: value})
            else:
                held = await connection.write_and_read_back({name: value}, tuple(safe_values))
        except DriverError as error:
            refused[name] = str(error)
    problems = []
    for name, value in safe_values.items():
        try:
            if name not in held:
                held |= await connection.read_back((name,))
        except DriverError as error:
            problems.append(refused.get(name) or str(error))
            continue
        # What is read back counts: a device may refuse to be told what it does already.
        if not abs(held[name] - value) <= count_tolerance(connection.rig.get(name)):
            problems.append(refused.get(name) or f"{name} holds {held[name]:g} instead of {value:g}")
    return "; ".join(dict.fromkeys(problems))


def _not_followed(connection: RigConnection, snapshot: Snapshot, safe_values: dict[str, float]) -> str:
    """Return which measured value is still away from its safe value, as a sentence, empty where there is none; raises
    DriverError of a link that is lost."""
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
