"""One CAN module behind every interface that can be had without a kernel's CAN: frames sent by hand."""

from __future__ import annotations

import asyncio
import contextlib
import os
import struct
import time
import tty
import uuid
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Protocol

import can

from drivers.can.bus import CanReceiver
from drivers.rig_file.bus_sections import CanBus
from drivers.rig_file.model import Point
from drivers.rig_file.reader import load_rig
from drivers.signals.points import Quality
from drivers.virtual.devices.socketcand import CanConnection, CanHub
from drivers.virtual.faults.faulty_link import FaultyLink, can_frames

INTERFACES = ("virtual", "socketcand", "slcan")
RIG = load_rig(Path(__file__).resolve().parents[2] / "profiles" / "rigs" / "virtual.toml")
UNWATCHED = {"bus": "c", "stale_after_s": 0.3, "max_change_per_s": None, "stuck_after_s": None, "plausible": None}
POINTS = tuple(p.model_copy(update=UNWATCHED) for p in RIG.point if p.bus == "thermocouples")


class Sender(Protocol):
    """The other side of the bus."""

    def send(self, identifier: int, data: bytes, *, extended: bool = False) -> None: ...

    def send_remote(self, identifier: int) -> None: ...


class VirtualSender:
    def __init__(self, channel: str) -> None:
        self.bus = can.Bus(interface="virtual", channel=channel)

    def send(self, identifier: int, data: bytes, *, extended: bool = False) -> None:
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=extended))

    def send_remote(self, identifier: int) -> None:
        self.bus.send(can.Message(arbitration_id=identifier, is_remote_frame=True, dlc=8, is_extended_id=False))


class HubSender:
    def __init__(self) -> None:
        self.hub = CanHub(time.time)

    def send(self, identifier: int, data: bytes, *, extended: bool = False) -> None:
        name = f"{identifier:08X}" if extended else f"{identifier:03X}"
        self.hub.publish(f"< frame {name} {time.time():.6f} {data.hex().upper()} >".encode(), 1)

    def send_remote(self, identifier: int) -> None:
        """The protocol has none."""


class SlcanSender:
    def __init__(self) -> None:
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self.path = os.ttyname(self._theirs)

    def send(self, identifier: int, data: bytes, *, extended: bool = False) -> None:
        name = f"T{identifier:08X}" if extended else f"t{identifier:03X}"
        self.say(f"{name}{len(data)}{data.hex().upper()}\r".encode())

    def send_remote(self, identifier: int) -> None:
        self.say(f"r{identifier:03X}8\r".encode())

    def say(self, text: bytes) -> None:
        os.write(self._ours, text)

    def close(self) -> None:
        os.close(self._ours)
        os.close(self._theirs)


class Heard:
    """The driver, who sends to it, and the wire between them where there is one."""

    def __init__(self, bus: CanReceiver, sender: Sender, link: FaultyLink | None) -> None:
        self.bus, self.sender, self.link = bus, sender, link
        self.epoch = 0

    def send_all(self) -> list[float]:
        """One period of the thermocouple module; what the points must read."""
        self.epoch += 1
        raws = [(k * 311 + self.epoch * 97) % 9000 for k in range(9)]
        uptime = 1000 * self.epoch
        self.sender.send(0x181, struct.pack("<4h", *raws[:4]))
        self.sender.send(0x281, struct.pack("<4h", *raws[4:8]))
        self.sender.send(0x381, struct.pack("<hHI", raws[8], 0, uptime))
        names = ("T_heater", *(f"T_pm{n}" for n in range(1, 7)), "T_radiator", "T_tank")
        truth = dict(zip(names, (raw * 0.01 for raw in raws), strict=True))
        truth |= {"tc_fault_bits": 0.0, "tc_uptime": uptime / 1000}
        return [truth[p.name] for p in POINTS]

    async def settled(self, frames: int, within_s: float = 3.0) -> None:
        """Until so many frames have come."""
        end = time.monotonic() + within_s
        while self.bus.frames < frames:
            assert time.monotonic() < end, f"{self.bus.frames} of {frames} frames within {within_s} s"
            await asyncio.sleep(0.005)

    async def good_again(self, within_s: float) -> None:
        """Send and read until everything is good and right."""
        end = time.monotonic() + within_s
        while True:
            truth = self.send_all()
            await asyncio.sleep(0.05)
            readings = await self.bus.read()
            right = all(abs(v - t) < 1e-6 for v, t in zip(readings.values, truth, strict=True))
            if right and set(readings.quality) == {Quality.GOOD}:
                return
            assert time.monotonic() < end, f"not good again within {within_s} s: {readings.fault}"


@contextlib.asynccontextmanager
async def heard(
    interface: str, points: tuple[Point, ...] = POINTS, dbc: Path | None = None, **keys: object
) -> AsyncIterator[Heard]:
    """A connected receiver on one interface."""
    common = {"dbc": dbc or RIG.bus["thermocouples"].dbc, "timeout_s": 0.5} | keys  # type: ignore[union-attr]
    link: FaultyLink | None = None
    sender: VirtualSender | HubSender | SlcanSender
    async with contextlib.AsyncExitStack() as stack:
        if interface == "virtual":
            channel = uuid.uuid4().hex
            sender = VirtualSender(channel)
            stack.callback(sender.bus.shutdown)
            config = CanBus(transport="virtual", channel=channel, **common)
        elif interface == "slcan":
            sender = SlcanSender()
            stack.callback(sender.close)
            config = CanBus(transport="slcan", channel=sender.path, bitrate=500_000, **common)
        else:
            sender = hub = HubSender()
            loop = asyncio.get_running_loop()
            server = await loop.create_server(lambda: CanConnection(hub.hub), "127.0.0.1", 0)
            stack.callback(lambda: [client.close() for client in list(hub.hub.clients)])
            stack.callback(server.close)
            link = await stack.enter_async_context(FaultyLink(server.sockets[0].getsockname()[1], can_frames))
            config = CanBus(transport="socketcand", port=link.port, channel="vcan0", **common)
        bus = CanReceiver("c", config, points, time.monotonic)
        stack.push_async_callback(bus.close)
        await bus.connect()
        if isinstance(sender, HubSender):
            while not sender.hub.listeners:
                await asyncio.sleep(0.01)
        yield Heard(bus, sender, link)
