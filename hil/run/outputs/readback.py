"""Set-points read back while a run goes on: one that the rig holds otherwise than this run wrote it is an alarm.

Another master is seen by what it leaves in the registers. Each check comes just before the set-points of a tick are
written, a whole period after the last ones: whatever another master wrote meanwhile is still there. Checks come at
irregular intervals, since a master that writes less often than this one, at a fixed period, could stay between regular
ones for ever. After a first foreign value every tick is checked for `CLOSE_S`, and a second one within that time is the
alarm. A single foreign value (a knob that was touched, a write that was lost) is overwritten on the same tick, and
only reported.

A value is foreign that lies outside of everything that this run wrote within the last interval, by more than half a raw
count. So a set-point may be moved on every tick, and a device may show what was written with a delay. A device that
rounds to coarser steps than its raw counts, or takes nothing at all, is found out by writing the same value once more:
see `_judge_foreign`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

from drivers.modbus.protocol import NO_SUCH_ADDRESS, NO_SUCH_FUNCTION
from drivers.rig import RigConnection
from drivers.rig_file import Point
from drivers.signals import DeviceExceptionError, DriverError, Quality, Snapshot
from hil.run.interlocks import TickValues
from hil.run.outputs.setpoints import count_tolerance

INTERVAL_S = 1.0
"""Mean interval between two checks, s of rig time: one request more a second on each device that is written to. Each
one lasts from half to one and a half of it: at one tick a second, one tick or two in no order."""
LOCKSTEP_INTERVAL_S = 10.0
"""The same in lockstep, where hours pass in seconds and nobody but the harness knows the virtual rig."""
CLOSE_S = 10.0
"""So long every tick is checked after a foreign value, and an alarm is present after the last one, s of rig time."""
ROUNDING = 0.05
"""Furthest that a device's rounding may take a set-point from what was written, of its limits' span: steps of a tenth
are the coarsest that drives and dimmers have. Further away it is not the device's rounding but another value."""
_GOLDEN = 0.6180339887498949
"""Steps by the golden ratio, modulo 1, come evenly close to every phase, and never repeat."""

_Written = tuple[float, dict[str, float]]


class SetpointReadback:
    """Condition that judges the set-points which a rig can be asked for (`access = "rw"`), as the rig holds them.

    `note` is given a level and a sentence for the run's events.
    """

    def __init__(self, connection: RigConnection, note: Callable[[str, str], None], *, lockstep: bool = False) -> None:
        self._connection = connection
        self._note = note
        self._interval_s = LOCKSTEP_INTERVAL_S if lockstep else INTERVAL_S
        self._close_s = max(CLOSE_S, 2.0 * self._interval_s)
        self._points: dict[str, tuple[Point, ...]] = {}
        for point in connection.rig.setpoints:
            if point.access == "rw":
                self._points[point.bus] = (*self._points.get(point.bus, ()), point)
        self._tolerance = {point.name: count_tolerance(point) for points in self._points.values() for point in points}
        self._written: deque[_Written] = deque()
        self._is_confirmed = True
        self._due_s = 0.0
        self._phase = 0.0
        self._foreign_s: dict[str, float] = {}  # of the latest foreign value
        self._found: dict[str, str] = {}

    @property
    def contested(self) -> bool:
        """Return True where a foreign value was found of late."""
        return bool(self._foreign_s)

    def not_confirmed(self) -> None:
        """Take note of a write that failed: the rig may hold the values before or after it, until the next one."""
        self._is_confirmed = False

    async def look(self, snapshot: Snapshot, written: Mapping[str, float], now_s: float) -> None:
        """Read set-points back where that is due, before those of this tick are written; raises nothing of a driver.

        `written` is what the rig was told last, engineering values by point; `now_s` is rig time in s. A device that
        cannot be reached is left to the interlocks on its link.
        """
        self._remember(written, now_s)
        confirmed, self._is_confirmed = self._is_confirmed, True
        if not confirmed or now_s < self._due_s:
            return
        for bus in self._reachable(snapshot):
            names = tuple(point.name for point in self._points[bus])
            try:
                held = await self._connection.read_back(names)
            except DeviceExceptionError as error:
                if error.code in (NO_SUCH_ADDRESS, NO_SUCH_FUNCTION):
                    self._give_up(bus, error)
                continue
            except DriverError:
                continue
            for point in self._points[bus]:
                if not self._is_own(point, held[point.name]):
                    await self._judge_foreign(point, held[point.name], now_s)
        self._forget(now_s)
        self._phase = (self._phase + _GOLDEN) % 1.0
        self._due_s = now_s if self._foreign_s else now_s + self._interval_s * (0.5 + self._phase)

    def judge(self, tick: TickValues, engaged: bool) -> str | None:
        """Violated from the second foreign value within `CLOSE_S` until there has been none for as long."""
        if not self._found:
            return None
        first, *more = self._found.values()
        return f"{first} (and {len(more)} more set-points)" if more else first

    def _remember(self, written: Mapping[str, float], now_s: float) -> None:
        """Keep what was written within the last interval, and what was in force when that began."""
        values = dict(written)
        if not self._written or self._written[-1][1] != values:
            self._written.append((now_s, values))
        while len(self._written) > 1 and self._written[1][0] < now_s - self._interval_s:
            self._written.popleft()

    def _reachable(self, snapshot: Snapshot) -> list[str]:
        """Return the buses that answered on this tick as far as is known."""
        rows = zip(self._connection.points, snapshot.quality, strict=True)
        lost = {point.bus for point, quality in rows if quality == Quality.LINK_FAULT}
        return [bus for bus in self._points if bus not in lost]

    def _is_own(self, point: Point, held: float) -> bool:
        """Return True where this run wrote `held` of late."""
        own = [values[point.name] for _, values in self._written if point.name in values]
        off = self._tolerance[point.name]
        return not own or min(own) - off <= held <= max(own) + off

    async def _judge_foreign(self, point: Point, held: float, now_s: float) -> None:
        """Count a foreign value: the first is reported, a second one within `CLOSE_S` is found."""
        unit, ours = point.unit, self._written[-1][1][point.name]
        again = point.name in self._foreign_s
        at_once = await self._told_again(point, ours) if again and point.name not in self._found else None
        own_doing = at_once is not None and abs(at_once - held) <= self._tolerance[point.name]
        if own_doing and self._rounds(point, held, ours):
            del self._foreign_s[point.name]
            return
        self._foreign_s[point.name] = now_s
        if own_doing:
            self._found[point.name] = (
                f"{point.name} holds {held:g} {unit} at once after {ours:g} {unit} was written: the device confirms "
                "what it is told and does not take it; look at its panel for a local mode, a lock or a limit of its own"
            )
        elif again:
            self._found[point.name] = (
                f"{point.name} holds {held:g} {unit}, this run wrote {ours:g} {unit}: another master writes to this "
                "rig, or a person at its panel; stop it before you go on"
            )
        else:
            self._note(
                "WARN",
                f"{point.name} held {held:g} {unit} where this run wrote {ours:g} {unit}; it is written again, and "
                f"another foreign value within {self._close_s:g} s is an alarm",
            )

    async def _told_again(self, point: Point, ours: float) -> float | None:
        """Return what the device holds at once when it is told again; None where it does not answer."""
        try:
            return (await self._connection.write_and_read_back({point.name: ours}, (point.name,)))[point.name]
        except DriverError:
            return None

    def _rounds(self, point: Point, held: float, ours: float) -> bool:
        """Return True where `held` is near enough to be the device's rounding of `ours`.

        Its tolerance is widened by so much, and that is reported.
        """
        assert point.limits is not None
        off = abs(held - ours)
        if off > ROUNDING * (point.limits[1] - point.limits[0]):
            return False
        self._tolerance[point.name] += off
        self._note(
            "WARN",
            f"{point.name} holds {held:g} {point.unit} at once when {ours:g} {point.unit} is written: the device "
            "rounds; give the point the scale of its steps",
        )
        return True

    def _forget(self, now_s: float) -> None:
        """Let go of foreign values that are `CLOSE_S` old."""
        for name, last_s in list(self._foreign_s.items()):
            if now_s - last_s > self._close_s:
                del self._foreign_s[name]
                self._found.pop(name, None)

    def _give_up(self, bus: str, error: DriverError) -> None:
        """Watch a device no longer that has no function to read its set-points with."""
        names = [point.name for point in self._points.pop(bus)]
        for name in names:
            self._foreign_s.pop(name, None)
            self._found.pop(name, None)
        listed = ", ".join(names)
        self._note(
            "WARN", f"another master would not be noticed: {listed} cannot be read back ({error}); give access = 'w'"
        )
