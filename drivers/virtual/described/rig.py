"""Devices of a rig file and the plant behind them, advanced a period at a time. No I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from drivers.can import EncodedFrame, FrameEncoder
from drivers.rig_file import CanBus, Point, Rig, located
from drivers.signals import CodecError
from drivers.virtual.described.memory import DeviceMemory
from drivers.virtual.described.plant import PlantModel
from drivers.virtual.described.watchdog import Watchdog

LONGEST_STEP_S = 1.0
"""Longest step of the plant and of the watchdog, s; a longer period takes several."""
_SECONDS = {"s": 1.0, "ms": 1e-3}


class DescribedRig:
    """Devices of a rig file with their registers and frames.

    Parameters
    ----------
    rig, file
        The rig and its file.
    plant
        Plant behind the devices.

    Raises
    ------
    ConfigurationError
        A DBC file cannot be used, or an expected text does not fit in its registers.
    """

    def __init__(self, rig: Rig, file: Path, plant: PlantModel) -> None:
        self.rig, self.time_s = rig, 0.0
        self.steps_of_a_period = max(math.ceil(rig.period_s / LONGEST_STEP_S - 1e-9), 1)
        self.step_s = rig.period_s / self.steps_of_a_period
        self.memories: dict[str, DeviceMemory] = {}
        self.encoders: dict[str, FrameEncoder] = {}
        self._plant = plant
        self._began_s, self._count = 0.0, 0
        self._points = {point.name: point for point in rig.point}
        for name, bus in rig.bus.items():
            points = [point for point in rig.point if point.bus == name]
            if isinstance(bus, CanBus):
                self.encoders[name] = FrameEncoder(name, bus, points)
            else:
                self.memories[name] = DeviceMemory(bus, points)
        beat = rig.heartbeat
        self.watchdog = None if beat is None else Watchdog(beat, rig.watchdog_s or rig.abort_after_s)
        self._hold_texts(file)
        self.restart()
        for memory in self.memories.values():
            memory.accepts = self._accepts
        self._values: Mapping[str, float] = self._plant.step(self._outputs(), 0.0)
        self._publish()

    def _hold_texts(self, file: Path) -> None:
        for index, point in enumerate(self.rig.point):
            if point.type != "string" or point.length is None:
                continue
            text = point.expect if point.expect is not None else point.name[: 2 * point.length]
            try:
                self.memories[point.bus].put_text(point, text)
            except CodecError as error:
                what = f"{point.name} cannot be served: {error}; correct expect or length"
                raise located(file, [(("point", index, "expect"), what)]) from None

    def restart(self) -> None:
        """Set the state after a power cut: set-points at their safe values, clocks at 0, not armed."""
        self._began_s, self._count = self.time_s, 0
        if self.watchdog is not None:
            self.watchdog.restart()
        for point in self.rig.point:
            if point.access != "r" and point.bus in self.memories:
                self._put(point, point.safe_value if point.safe_value is not None else 0.0)
        beat = self.rig.heartbeat
        if beat is not None and beat.watchdog is not None:
            self._put(self._points[beat.watchdog], self.rig.watchdog_s or 0.0)

    def step(self) -> None:
        """Advance rig time by one step: watchdog, plant, registers."""
        self.time_s += self.step_s
        self._count += 1
        beat, dog = self.rig.heartbeat, self.watchdog
        if beat is not None and dog is not None:
            held_s = None if beat.watchdog is None else self._value(beat.watchdog)
            if dog.trips(self.time_s, held_s):
                if beat.arm is not None:
                    self._put(self._points[beat.arm], 0.0)
                for point in self.rig.setpoints:
                    self._put(point, point.safe_value or 0.0)
        self._values = self._plant.step(self._outputs(), self.step_s)
        self._publish()

    def frames(self, bus: str) -> list[EncodedFrame]:
        """Return the frames of a CAN bus with the values of the last step."""
        return self.encoders[bus].frames(self._known())

    def _outputs(self) -> dict[str, float]:
        """Return the set-points that reach the plant, by name."""
        if self.watchdog is None or self.watchdog.lets_through:
            return {point.name: self._value(point.name) for point in self.rig.setpoints}
        return {point.name: point.safe_value or 0.0 for point in self.rig.setpoints}

    def _accepts(self) -> bool:
        return self.watchdog is None or self.watchdog.accepts(self.time_s, self._value)

    def _value(self, name: str) -> float:
        point = self._points[name]
        return self.memories[point.bus].value(point)

    def _put(self, point: Point, value: float) -> None:
        self.memories[point.bus].put(point, value)

    def _clocks(self) -> dict[str, float]:
        """Return the values that the devices themselves give: clocks, the cycle counter, the state of the watchdog."""
        found: dict[str, float] = {}
        for bus in self.rig.bus.values():
            if bus.uptime is not None:
                unit_s = _SECONDS.get(self._points[bus.uptime].unit, 1.0)
                found[bus.uptime] = (self.time_s - self._began_s) / unit_s
        beat = self.rig.heartbeat
        if beat is not None and beat.counter is not None:
            point = self._points[beat.counter]
            found[beat.counter] = self._count * abs(point.scale) + point.offset
        if beat is not None and beat.status is not None and self.watchdog is not None:
            found[beat.status] = float(self.watchdog.status)
        return found

    def _known(self) -> dict[str, float]:
        return {**self._values, **self._clocks()}

    def _publish(self) -> None:
        """Put all values that are polled into the registers."""
        clocks = self._clocks()
        status = None if self.rig.heartbeat is None else self.rig.heartbeat.status
        for point in self.rig.point:
            if not point.is_polled or point.bus not in self.memories:
                continue
            memory = self.memories[point.bus]
            if point.name in clocks and point.name != status:
                memory.put_count(point, clocks[point.name])
            else:
                memory.put(point, clocks.get(point.name, self._values.get(point.name, 0.0)))
