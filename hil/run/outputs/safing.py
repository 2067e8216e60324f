"""Making the rig safe: the one way in which every run ends, and the one place that decides whether it worked.

Safe means read back from the rig *and* measured: while a heater's meter reads more than its limit (`heaters`) the
rig is not safe, and while the meter does not come down it gets no heartbeat, so that its own watchdog can act.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass

from drivers.rig import RigConnection
from drivers.rig_file import Rig
from drivers.signals import DeviceExceptionError, DriverError, Snapshot
from hil.run.outputs.heaters import Descent, good_readings, is_heater, not_cold, safe_limits
from hil.run.outputs.setpoints import count_tolerance

WRITE_DEADLINE_S = 30.0
HURRIED_WRITE_DEADLINE_S = 5.0
"""Time for which a lost link is tried again with the safe values, s of wall time; the same after a second signal."""
ATTEMPT_S = 3.0
"""Time that one attempt may take beyond the time-outs of a write and its read-back, s: some ten requests of a device
that answers in 0.3 s."""
REWRITE_EVERY_S = 0.5
"""Interval at which the safe values are written again while the meters come down, s of rig time."""
QUIET_S, CONTEST_S = 10.0, 30.0
"""Time for which another master has to leave the safe values alone before they count as held, and the longest time
that is waited for that, s of rig time: as long as a second foreign value is waited for while a run goes on."""
LAST_TRIES = 3
"""So often the last word is tried again: one reply that a busy machine or line delays makes no rig unsafe."""
RETRY_EVERY_S = 0.1
"""Interval of these attempts, s."""
REOPENED_S = 0.2
"""Time in which a connection that a mute device has cost is open again, s: as long as a request to another device on
the same wire waits for that."""


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


@dataclass(frozen=True, slots=True)
class Meanwhile:
    """Calls while the rig is made safe.

    Attributes
    ----------
    progress
        Before each attempt.
    failed
        After each that failed; returns whether somebody else has made the rig safe.
    stays
        Which meter does not come down, counted from when its heater was first told to be safe; None counts from now.
    contested
        Returns whether another master has written to the rig of late.
    """

    progress: Callable[[], None] = lambda: None
    failed: Callable[[], bool] = lambda: False
    stays: Callable[[Mapping[str, float]], str] | None = None
    contested: Callable[[], bool] = lambda: False


async def make_safe(
    connection: RigConnection,
    safe_values: dict[str, float],
    *,
    heartbeat: Callable[[], dict[str, float]],
    advance: Callable[[], Awaitable[None]],
    period_s: float,
    hurried: Callable[[], bool],
    meanwhile: Meanwhile | None = None,
) -> Safed:
    """Write the safe values in their order, read them back, and wait until the measured values follow.

    A lost link is retried for `WRITE_DEADLINE_S` of wall time. The function raises nothing.

    Parameters
    ----------
    connection
        Connection to the rig.
    safe_values
        Set-point -> safe value in its unit, in the order of writing.
    heartbeat
        Function that returns the values of the next heartbeat.
    advance
        Function that lets one period of rig time pass.
    period_s
        Period of the rig, s.
    hurried
        Function that turns true when the waits are to be cut short; writing and read-back never are.
    meanwhile
        Reports and checks while the function waits, or None for none.
    """
    meanwhile = meanwhile or Meanwhile()
    began = time.monotonic()
    while True:
        meanwhile.progress()
        left_s = began + (HURRIED_WRITE_DEADLINE_S if hurried() else WRITE_DEADLINE_S) - time.monotonic()
        problem = await write_safe(connection, safe_values, within_s=max(left_s, attempt_s(connection.rig)))
        if not problem:
            break
        if meanwhile.failed():
            return Safed(True, True, "")
        if left_s <= 0.0:
            return Safed(False, False, problem)
        await asyncio.sleep(RETRY_EVERY_S)
    waits = [connection.rig.get(name).readback_within_s for name in safe_values]
    limits, held_s = safe_limits(connection.rig), time.monotonic()
    hot = "no meter was read" if limits else ""
    fresh, stays = Descent(connection.rig, limits, period_s), meanwhile.stays
    busy_s = 0.0
    every = max(round(REWRITE_EVERY_S / period_s), 1)
    for number in range(math.ceil(max(waits, default=0.0) / period_s)):
        meanwhile.progress()
        asked_s = time.monotonic()
        try:
            snapshot = await connection.read()
            problem = _not_followed(connection, snapshot, safe_values)
            readings = good_readings(connection.points, snapshot)
            hot = not_cold(connection.rig, limits, readings)
            problem = hot or problem
            if not problem or hurried():
                break
            disobeyed = stays(readings) if stays is not None else fresh.stays(readings, number * period_s)
            if not disobeyed:
                await connection.write(heartbeat())
            if disobeyed or number % every == every - 1:  # another master may have written since
                problem = await write_safe(connection, safe_values, within_s=attempt_s(connection.rig)) or problem
            busy_s += time.monotonic() - asked_s
            if busy_s > max(waits) + WRITE_DEADLINE_S:
                break  # devices that do not answer take all of the time
            await advance()
        except DriverError as error:
            problem = str(error)
            if hurried() or time.monotonic() - held_s > max(waits) + WRITE_DEADLINE_S:
                break
            await asyncio.sleep(RETRY_EVERY_S)
    rival = ""
    if await _overwritten(connection, safe_values) or meanwhile.contested():
        rival = await _rival(connection, safe_values, advance, period_s, hurried, meanwhile)
    # The last word, whoever has written meanwhile.
    again = await write_safe(connection, safe_values, within_s=attempt_s(connection.rig))
    for _ in range(LAST_TRIES):
        if not again:
            break
        await asyncio.sleep(RETRY_EVERY_S)
        again = await write_safe(connection, safe_values, within_s=attempt_s(connection.rig))
    again = again or rival
    return Safed(not again, not (problem or again), again or problem, hot)


async def _overwritten(connection: RigConnection, safe_values: Mapping[str, float]) -> str:
    """Return which safe value the rig holds no more, as a sentence; empty where it holds all that it can be asked
    for."""
    names = tuple(name for name in safe_values if connection.rig.get(name).access == "rw")
    try:
        held = await connection.read_back(names)
    except DriverError:
        return ""  # that is seen by the last word
    for name in names:
        point = connection.rig.get(name)
        if not abs(held[name] - safe_values[name]) <= count_tolerance(point):
            return f"{name} held {held[name]:g} {point.unit} after {safe_values[name]:g} {point.unit} was read back"
    return ""


async def _rival(
    connection: RigConnection,
    safe_values: dict[str, float],
    advance: Callable[[], Awaitable[None]],
    period_s: float,
    hurried: Callable[[], bool],
    meanwhile: Meanwhile,
) -> str:
    """Return what another master goes on to write over the safe values, as a sentence; empty once it has left them
    alone for `QUIET_S`.

    Whatever it writes is written over at once. The rig gets no heartbeat meanwhile, so that its own watchdog can cut
    what the other asks for.
    """
    found, quiet_s, times = "", 0.0, 0
    for _ in range(math.ceil(CONTEST_S / period_s)):
        meanwhile.progress()
        overwritten = await _overwritten(connection, safe_values)
        if overwritten:
            found, quiet_s, times = overwritten, 0.0, times + 1
            await write_safe(connection, safe_values, within_s=attempt_s(connection.rig))
        elif quiet_s >= QUIET_S:
            return ""
        if hurried():
            break
        quiet_s += period_s
        await advance()
    if not found:
        return ""
    return f"{found} ({times} times while it was watched): another master goes on writing to this rig; stop it"


def attempt_s(rig: Rig) -> float:
    """Return the longest time that one attempt to make `rig` safe may take, s: a mute device holds it up no longer."""
    timeouts = [rig.bus[point.bus].timeout_s for point in rig.setpoints]
    return ATTEMPT_S + 2.0 * max(timeouts, default=0.0)


async def write_safe(connection: RigConnection, safe_values: dict[str, float], within_s: float = math.inf) -> str:
    """Write in order and read back, once; return what went wrong, or an empty string.

    Each output is tried whatever became of the others: a pump that refuses must not keep the heater on. Wires are
    written to at the same time, each for `within_s` of wall time at most: a device that is mute keeps no other waiting.
    """
    groups = [{name: safe_values[name] for name in group} for group in connection.by_wire(safe_values)]
    if len(groups) == 1 and within_s == math.inf:
        return await _write_wire(connection, safe_values)
    limit_s = None if within_s == math.inf else within_s
    tasks = [asyncio.ensure_future(_write_wire(connection, group)) for group in groups]
    try:
        if tasks:
            await asyncio.wait(tasks, timeout=limit_s)
        problems = []
        for task, group in zip(tasks, groups, strict=True):
            late = f"{', '.join(group)}: the device gave no answer within {within_s:g} s"
            problems.append(task.result() if task.done() else late)
        return "; ".join(problem for problem in problems if problem)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _write_wire(connection: RigConnection, safe_values: dict[str, float]) -> str:
    """Write the safe values of one wire in order and read them back; return what went wrong.

    The order holds while devices answer: once one is mute, heaters come next, and what is mute comes last. Its silence
    may have cost the connection: a heater is tried again when that had the time to be opened anew.
    """
    rig = connection.rig
    refused: dict[str, str] = {}
    held: dict[str, float] = {}
    mute: set[str] = set()
    again: set[str] = set()
    pending = list(safe_values)
    while pending:
        name = pending.pop(0)
        value = safe_values[name]
        try:
            refused.pop(name, None)
            if pending or refused:
                await connection.write({name: value})
            else:
                held = await connection.write_and_read_back({name: value}, tuple(safe_values))
        except DriverError as error:
            refused[name] = str(error)
            if not isinstance(error, DeviceExceptionError):
                if is_heater(rig, rig.get(name)) and name not in again:
                    again.add(name)
                    pending.insert(0, name)
                    await asyncio.sleep(REOPENED_S)
                mute.add(rig.get(name).bus)
                pending.sort(key=lambda other: (rig.get(other).bus in mute, not is_heater(rig, rig.get(other))))
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
    DriverError where the link to one of them is lost. Other devices may be mute: they hold up nothing here."""
    measured = dict(zip((point.name for point in connection.points), snapshot.values, strict=True))
    for name, value in safe_values.items():
        point = connection.rig.get(name)
        if point.readback is None:
            continue
        now = measured.get(point.readback, math.nan)
        if math.isnan(now) and snapshot.faults:
            raise DriverError(snapshot.faults[0])
        if not abs(now - value) <= point.readback_tolerance:
            return f"{point.readback} reads {now:.1f} {point.unit} where {value:g} {point.unit} is safe"
    return ""
