"""A rig in virtual time behind the engine's port: the virtual PLC's own registers and watchdog, faults on demand."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.rig_file.interlock_specs import (
    HeaterPowerSpec,
    LimitSpec,
    NoFlowSpec,
    RateOfRiseSpec,
    ResidualSpec,
)
from drivers.rig_file.model import Rig
from drivers.rig_file.reader import load_rig
from drivers.signals.points import LinkError, Quality, Snapshot
from drivers.virtual.devices.registers import ARMED, HEARTBEAT, HEATER_SET, Registers
from hil.journal.writer import JournalError

PROJECT = Path(__file__).resolve().parents[2]
SHIPPED = load_rig(PROJECT / "profiles" / "rigs" / "virtual.toml")
WARNING = {"level": "warning", "deadband": 2.0, "off_delay_s": 5.0}
INTERLOCKS = (
    LimitSpec(kind="limit", point="T_tank", high=60.0, **WARNING),
    RateOfRiseSpec(kind="rate_of_rise", level="alarm", point="T_pm1", high=2.0, window_s=4.0),
    NoFlowSpec(kind="no_flow", level="alarm", heater="heater_power", above=20.0, flow="flow", low=0.5, on_delay_s=2.0),
    HeaterPowerSpec(kind="heater_power", level="alarm", setpoint="heater_power_set", tolerance=100.0, on_delay_s=3.0),
    ResidualSpec(kind="residual", sensor="T_tank", high=3.0, **WARNING),
)


def rig_with(
    acknowledge_within_s: float = 0.0, interlocks: tuple[Any, ...] = INTERLOCKS, suspend_at_most_s: float = 0.0
) -> Rig:
    """The shipped rig with interlocks of every kind."""
    waits = {"acknowledge_within_s": acknowledge_within_s, "suspend_at_most_s": suspend_at_most_s}
    return SHIPPED.model_copy(update={**waits, "interlock": interlocks})


START_QUALITY: dict[str, Quality] = {}
"""Of what is not good from the beginning."""
START_TRIPS = 0
"""Bits of its own trips that the rig brings along."""
START_HEATER_W = 0.0
"""What a rig that is armed brings along: somebody else left it heating."""


class SimulatedRig:
    """What a `RigConnection` is to the engine. The plain attributes are what a test does to it."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.points = tuple(point for point in rig.point if point.access == "r")
        self.registers = Registers()
        self.registers.status = START_TRIPS | (ARMED if START_HEATER_W else 0)
        self.registers.holding[HEATER_SET] = round(START_HEATER_W * 10.0)
        self.now = self._booted = 0.0
        self.link = True
        self.counts = True
        self.loses_writes = False
        self.drops_writes = False
        self.confirms = True
        self.readings: dict[str, float] = {}
        self.quality: dict[str, Quality] = dict(START_QUALITY)
        self.faults: list[str] = []
        self.water_C = 40.0
        self.watch: Callable[[float], None] = lambda passed_s: None
        self._power = self.registers.heater_W
        self._cycle = 0
        self._address = {point.name: point for point in rig.point if point.access != "r"}

    @property
    def heater_W(self) -> float:
        """What reaches the heater now."""
        return self.registers.heater_W

    def pass_time(self, seconds: float) -> None:
        """Let rig time go on."""
        self.now += seconds
        if self.counts:
            self._cycle = (self._cycle + 1) % 65536
        self.registers.supervise(self.now, self.water_C)
        self._power = self.registers.heater_W
        self.watch(seconds)

    def reboot(self) -> None:
        """The PLC starts anew: nothing is armed, nothing is set."""
        self.registers = Registers()
        self.registers.now = self._booted = self.now
        self._cycle = 0

    exhausted: str | None = None

    async def connect(self) -> None:
        self._reach()

    async def close(self) -> None:
        pass

    async def wait_for_device_time(self, device_time_s: float, timeout_s: float) -> None:
        pass

    def by_wire(self, names: Iterable[str]) -> list[tuple[str, ...]]:
        return [tuple(names)]

    async def first_complete(self, timeout_s: float) -> Snapshot:
        return await self.read()

    async def read(self) -> Snapshot:
        known = {"heater_power": self._power, "flow": 3.8, "pump_speed": 100.0, "fan_speed": 100.0, "T_ambient": 20.0}
        known["plc_uptime"] = self.now - self._booted
        known |= {"plc_status": float(self.registers.status), "cycle_counter": float(self._cycle)} | self.readings
        quality = {name: int(value) for name, value in self.quality.items()}
        if not self.link:
            quality |= {point.name: int(Quality.LINK_FAULT) for point in self.points if point.bus == "plc"}
        return Snapshot(
            [math.nan if quality.get(p.name) else known.get(p.name, 30.0) for p in self.points],
            [quality.get(p.name, int(Quality.GOOD)) for p in self.points],
            [self.now] * len(self.points),
            self.faults if self.link else ["plc: no answer"],
        )

    async def write(self, values: dict[str, float]) -> None:
        self._reach()
        if self.loses_writes:
            self.pass_time(0.1)  # whoever tries again waits in between
            return
        if self.drops_writes:
            self.pass_time(0.1)
            raise LinkError("plc: no answer to a write within 0.5 s")
        for name, value in values.items():
            point = self._address[name]
            self.registers.write(point.address, [round(value / point.scale)])
        if not self.confirms:
            raise LinkError("plc: no answer to a write within 0.5 s")

    async def write_and_read_back(self, values: dict[str, float], names: tuple[str, ...]) -> dict[str, float]:
        await self.write(values)
        return await self.read_back(names)

    async def read_back(self, names: tuple[str, ...]) -> dict[str, float]:
        self._reach()
        return {n: self.registers.holding[self._address[n].address] * self._address[n].scale for n in names}

    def _reach(self) -> None:
        if not self.link:
            self.pass_time(0.1)  # a time-out takes its time
            raise LinkError("plc: no answer")

    @property
    def armed(self) -> bool:
        return bool(self.registers.status & ARMED)

    @property
    def beat(self) -> int:
        return self.registers.holding[HEARTBEAT]


class SimulatedClock:
    """Ticks that a test grants one by one; `period_s` of rig time each."""

    def __init__(self, rig: SimulatedRig) -> None:
        self.period_s = 1.0
        self.overruns = 0
        self.granted = asyncio.Semaphore(0)
        self.asked = 0
        self._rig = rig
        self._tick = -1

    def now(self) -> float:
        return self._rig.now

    async def start(self) -> None:
        self._tick = -1

    def current_tick(self) -> int:
        return self._tick

    def release(self) -> None:
        pass

    async def next_tick(self) -> int:
        self.asked += 1
        await self.granted.acquire()
        self._rig.pass_time(self.period_s)
        self._tick += 1
        return self._tick

    async def advance(self, at_most_s: float = math.inf) -> None:
        self._rig.pass_time(self.period_s)
        await asyncio.sleep(0)

    async def wait(self) -> None:
        pass

    async def close(self) -> None:
        pass


@dataclass
class MemoryJournal:
    """What was journaled, as lists; a `broken` one refuses everything."""

    broken: bool = False
    failure: str | None = None
    states: list[tuple[Any, ...]] = field(default_factory=list)
    events: list[tuple[str, str]] = field(default_factory=list)
    samples: list[tuple[Any, ...]] = field(default_factory=list)
    segments: list[Any] = field(default_factory=list)

    def sample(self, *row: Any) -> None:
        self.samples.append(row)

    def state(self, *row: Any) -> None:
        self.states.append(row)

    def write(self, *row: Any) -> None:
        pass

    def segment(self, row: Any) -> None:
        self._refuse()
        self.segments.append(row)

    def event(self, tick: int, time_s: float, level: str, text: str) -> None:
        self._refuse()
        self.events.append((level, text))

    behind_s = 0.0

    def check(self) -> None:
        self._refuse()

    def _refuse(self) -> None:
        if self.broken:
            raise JournalError("journal.sqlite cannot be written (database or disk is full)")


class RigTime:
    """Stands in for `time` where safing measures its deadline, so that it is in rig time."""

    def __init__(self, rig: SimulatedRig) -> None:
        self._rig = rig

    def monotonic(self) -> float:
        return self._rig.now
