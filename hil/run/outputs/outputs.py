"""Outputs to the rig on a tick: set-points, heartbeat, arming. The heartbeat comes after everything else."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable, Mapping

from drivers.rig import RigConnection
from drivers.signals import DeviceExceptionError, DriverError, LinkError, Snapshot
from hil.run.outputs.safing import write_safe
from hil.run.outputs.setpoints import Setpoints, count_tolerance

ARMING_TICKS = 3
"""Steps in which a rig may release its trip after it was armed; beyond, it stays tripped."""
_HELD = 0.01
"""Largest relative difference of a time-out that is read back from the one written: digits that a float loses."""


class Outputs:
    """Set-points of a rig from its safe values on.

    Attributes
    ----------
    values
        What the rig was told last, or holds where a write was not confirmed and it could be asked, by point.
    unknown
        Points whose value in the rig is one of two: a write of them was not confirmed.
    unconfirmed
        Why the rig has not confirmed what it was told last; empty where it has.
    """

    def __init__(self, connection: RigConnection) -> None:
        self._connection = connection
        self._rig = connection.rig
        self._setpoints = Setpoints(self._rig)
        self.values: dict[str, float] = self._setpoints.values
        self.unknown: frozenset[str] = frozenset()
        self.unconfirmed = ""
        self._beat = 0
        self._safe_held = False

    @property
    def safe_values(self) -> dict[str, float]:
        """Return the safe value of each set-point, in the order in which they are applied."""
        return self._setpoints.safe_values()

    @property
    def safe_held(self) -> bool:
        """Return whether the rig holds the safe values, read back from it."""
        return self._safe_held

    def heartbeat(self) -> dict[str, float]:
        """Return the next beat; nothing for a rig that wants none."""
        if self._rig.heartbeat is None:
            return {}
        self._beat = (self._beat + 1) % 65536
        return {self._rig.heartbeat.point: float(self._beat)}

    async def arm(self, advance: Callable[[], Awaitable[None]], tripped: Callable[[Snapshot], str | None]) -> None:
        """Write safe set-points, give the rig's watchdog its time-out, start the heartbeat, arm the outputs.

        Raises LinkError where the rig does not hold that time-out, stays tripped or refuses to be armed.
        """
        await self._connection.write(self.values)
        if self._rig.heartbeat is None:
            return
        await self._set_watchdog()
        await self._count_on()
        why: str | None = None
        for _ in range(ARMING_TICKS):
            await self._connection.write(self.heartbeat())
            refused = None
            try:
                await self._write_arm()
            except DeviceExceptionError as error:  # a rig may wait for a beat that it has seen change
                refused = f"the rig refuses to be armed ({error})"
            await advance()
            why = tripped(await self._connection.read()) or refused
            if why is None:
                return
        raise LinkError(f"not started: {why}")

    async def _count_on(self) -> None:
        """Count on from the beat that the rig holds: it waits for another one, and a run that was killed may have left
        the one that this run would begin with.
        """
        assert self._rig.heartbeat is not None
        name = self._rig.heartbeat.point
        if self._rig.get(name).access != "rw":
            return
        with contextlib.suppress(DriverError):  # a device that does not tell is armed on a later tick
            held = (await self._connection.read_back((name,)))[name]
            self._beat = round(held) % 65536 if math.isfinite(held) else self._beat

    async def move(self, targets: Mapping[str, float], elapsed_s: float) -> dict[str, float]:
        """Move towards `targets` for `elapsed_s`, or keep what is where there are none; return the values that changed.

        What a lost or garbled write did not confirm is read back; where it cannot be, it has not moved, and when the
        link is back, the slew rate counts from here. Raises a DriverError.
        """
        self._safe_held = False
        before = dict(self.values)
        changed = self._setpoints.move(dict(targets), elapsed_s)
        wanted = dict(self.values)
        try:
            await self._connection.write(wanted | self.heartbeat())
        except DeviceExceptionError:
            raise
        except DriverError as error:
            self.values.update(before)
            held = await self._held(wanted)
            self.values.update(held)
            self.unknown = (self.unknown | changed.keys()) - held.keys()
            self.unconfirmed = str(error)
            raise
        self.unknown, self.unconfirmed = frozenset(), ""
        return changed

    async def _held(self, wanted: Mapping[str, float]) -> dict[str, float]:
        """Return what the rig holds of the set-points that it can be asked for; `wanted` where it is that."""
        found: dict[str, float] = {}
        for bus in self._rig.bus:
            names = tuple(p.name for p in self._rig.setpoints if p.bus == bus and p.access == "rw" and p.name in wanted)
            if not names:
                continue
            with contextlib.suppress(DriverError, TimeoutError):
                async with asyncio.timeout(self._rig.bus[bus].timeout_s):
                    found |= await self._connection.read_back(names)
        return {
            name: wanted[name] if abs(held - wanted[name]) <= count_tolerance(self._rig.get(name)) else held
            for name, held in found.items()
        }

    async def put_safe(self, *, arm: bool, hot: str = "") -> None:
        """Write the safe values in their order and read them back, once; then keep them, and `arm` where asked.

        Until they are held, and while a meter contradicts them (`hot`), the rig gets no heartbeat, so that its watchdog
        may act. Raises a DriverError.
        """
        self._setpoints.put_safe()
        if not self._safe_held:
            problem = await write_safe(self._connection, self.safe_values)
            if problem:
                self.unknown, self.unconfirmed = frozenset(self.values), problem
                raise LinkError(f"not safe yet, trying again: {problem}")
        self._safe_held = False
        self.unconfirmed = "the safe values were not confirmed again"
        await self._connection.write(self.values | ({} if hot and not arm else self.heartbeat()))
        self._safe_held = True
        self.unknown, self.unconfirmed = frozenset(), ""
        if arm:
            await self._set_watchdog()  # a rig that began anew has forgotten it
            await self._write_arm()

    async def _set_watchdog(self) -> None:
        """Have the rig hold the time-out of its own watchdog, read back; nothing where it is not told how."""
        seconds = self._rig.watchdog_s
        if seconds is None:
            return
        assert self._rig.heartbeat is not None and self._rig.heartbeat.watchdog is not None
        name = self._rig.heartbeat.watchdog
        try:
            held = (await self._connection.write_and_read_back({name: seconds}, (name,)))[name]
        except DeviceExceptionError as error:
            raise LinkError(
                f"not armed: the rig refuses a watchdog time-out of {seconds:g} s ({error}); correct watchdog_s"
            ) from error
        if not abs(held - seconds) <= _HELD * seconds:
            raise LinkError(
                f"not armed: {name} holds {held:g} s instead of the {seconds:g} s that the rig's own watchdog is to "
                "wait; it may be locked in the rig: have it released, or take watchdog out of the rig file"
            )

    async def _write_arm(self) -> None:
        if self._rig.heartbeat is not None and self._rig.heartbeat.arm is not None:
            await self._connection.write({self._rig.heartbeat.arm: 1.0})
