"""Connection to a rig: all buses of a rig file, opened together, polled together, written by point name."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterable, Mapping

from drivers.bus import Bus, Clock, Readings
from drivers.can import CanReceiver
from drivers.modbus import ModbusBus, ModbusLink
from drivers.rig_file import CanBus, Point, Rig, wire_of_bus
from drivers.signals import DriverError, LinkError, Signal, Snapshot


async def _read_in_turn(sharing: list[ModbusBus]) -> dict[str, Readings]:
    """Return readings of devices on one wire; mute devices are read last, since others wait for their deadlines."""
    if len(sharing) > 1:
        sharing = sorted(sharing, key=lambda bus: bus.is_mute)
    return {bus.name: await bus.read() for bus in sharing}


class RigConnection:
    """Open buses of `rig`. `signals` are the polled points, in the order of every `Snapshot`."""

    def __init__(self, rig: Rig, clock: Clock) -> None:
        self.rig = rig
        self._buses: dict[str, Bus] = {}
        self._receivers: list[CanReceiver] = []
        self._wires: dict[str, list[ModbusBus]] = {}
        wire = self._wire_of = wire_of_bus(rig)
        for name, config in rig.bus.items():
            points = tuple(point for point in rig.point if point.bus == name)
            if isinstance(config, CanBus):
                receiver = CanReceiver(name, config, points, clock)
                self._receivers.append(receiver)
                self._buses[name] = receiver
            else:
                sharing = self._wires.setdefault(wire[name], [])
                link = sharing[0].link if sharing else ModbusLink(config)
                device = ModbusBus(name, config, points, clock, link)
                sharing.append(device)
                self._buses[name] = device
        self._all = list(self._buses.values())
        self.points: tuple[Point, ...] = tuple(point for bus in self._all for point in bus.points)
        self.signals: tuple[Signal, ...] = tuple(point.as_signal() for point in self.points)
        self._bus_of = {point.name: point.bus for point in rig.point}

    async def connect(self) -> None:
        """Open all buses at once; raise one LinkError that names every bus that failed, after closing the others."""
        results = await asyncio.gather(*(bus.connect() for bus in self._all), return_exceptions=True)
        failed = [result for result in results if isinstance(result, BaseException)]
        if not failed:
            return
        await self.close()
        for error in failed:
            if not isinstance(error, DriverError):
                raise error
        if len(failed) == 1:
            raise failed[0]
        raise LinkError("\n".join(str(error) for error in failed))

    async def read(self) -> Snapshot:
        """Return this tick's readings of all polled points: wires concurrently, devices on one wire in turn."""
        snapshot = Snapshot([], [], [])
        heard: dict[str, Readings] = {}
        wires = list(self._wires.values())
        if len(wires) == 1:
            heard = await _read_in_turn(wires[0])
        else:
            for one in await asyncio.gather(*(_read_in_turn(sharing) for sharing in wires)):
                heard |= one
        for bus in self._all:
            readings = heard[bus.name] if bus.name in heard else await bus.read()
            snapshot.values += readings.values
            snapshot.quality += readings.quality
            snapshot.source_time_s += readings.source_time_s
            if readings.fault is not None:
                snapshot.faults.append(readings.fault)
        return snapshot

    @property
    def exhausted(self) -> str | None:
        """Sentence where this machine has no descriptor or memory left to reach a device; None while it has."""
        links = {id(bus.link): bus.link for sharing in self._wires.values() for bus in sharing}
        return next((link.exhausted for link in links.values() if link.exhausted is not None), None)

    def by_wire(self, names: Iterable[str]) -> list[tuple[str, ...]]:
        """Return writable points in groups that share a wire, in order: groups can be written at the same time."""
        found: dict[str, list[str]] = {}
        for name in names:
            found.setdefault(self._wire_of[self._bus_of[name]], []).append(name)
        return [tuple(group) for group in found.values()]

    async def write(self, values: Mapping[str, float]) -> None:
        """Write engineering values by point name, one request for adjacent registers; raise a DriverError."""
        for name, bus in self._buses.items():
            mine = {point: value for point, value in values.items() if self._bus_of[point] == name}
            if mine:
                await bus.write(mine)

    async def write_and_read_back(self, values: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
        """Write `values`, then return writable points `names` as the devices hold them; raise a DriverError.

        This is one request where the device has function 23 and all points are within its limits.
        """
        owners = {self._bus_of[point] for point in values}
        if len(owners) != 1:
            await self.write(values)
            return await self.read_back(names)
        (owner,) = owners
        mine = tuple(point for point in names if self._bus_of[point] == owner)
        found = await self._buses[owner].write_and_read_back(values, mine)
        return found | await self.read_back(tuple(point for point in names if self._bus_of[point] != owner))

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        """Return writable points as the devices hold them; raise a DriverError."""
        found: dict[str, float] = {}
        for name, bus in self._buses.items():
            mine = tuple(point for point in names if self._bus_of[point] == name)
            if mine:
                found |= await bus.read_back(mine)
        return found

    async def wait_for_device_time(self, device_time_s: float, timeout_s: float) -> None:
        """Return once every bus that sends unasked has delivered samples of `device_time_s` (s); raise LinkError."""
        for receiver in self._receivers:
            await receiver.wait_for_device_time(device_time_s, timeout_s)

    async def first_complete(self, timeout_s: float) -> Snapshot:
        """Return the first snapshot with every point received; raise LinkError naming the missing."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        while True:
            snapshot = await self.read()
            silent = [
                point.name for point, time in zip(self.points, snapshot.source_time_s, strict=True) if math.isnan(time)
            ]
            if not silent:
                return snapshot
            if loop.time() > deadline:
                causes = ": " + "; ".join(snapshot.faults) if snapshot.faults else ""
                raise LinkError(f"nothing heard of {', '.join(silent)} within {timeout_s:g} s{causes}")
            await asyncio.sleep(0.02)

    async def close(self) -> None:
        """Close all buses; never raise."""
        await asyncio.gather(*(bus.close() for bus in self._all), return_exceptions=True)


def rig_signals(rig: Rig) -> tuple[Signal, ...]:
    """Return the signals of a rig that are polled, then those that are commanded."""
    return RigConnection(rig, lambda: 0.0).signals + tuple(point.as_signal() for point in rig.setpoints)
