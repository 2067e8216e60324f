"""The CAN driver on a socketcand hub: values, sentinels, staleness, unknown and short frames, a hub that goes away."""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections.abc import AsyncIterator
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.bus import CanReceiver
from drivers.rig_file.bus_sections import CanBus
from drivers.rig_file.model import Point
from drivers.rig_file.reader import load_rig
from drivers.signals.points import ConfigurationError, LinkError, Quality
from drivers.virtual.devices.socketcand import CanConnection, CanHub, frame_text

PROJECT = Path(__file__).resolve().parents[2]
RIG = load_rig(PROJECT / "profiles" / "rigs" / "virtual.toml")
POINTS = tuple(p for p in RIG.point if p.bus == "thermocouples")
DBC = RIG.bus["thermocouples"].dbc


class Hub:
    """The hub of the virtual rig, fed by hand."""

    def __init__(self) -> None:
        self.hub = CanHub(time.time)
        self.port = 0
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: CanConnection(self.hub), "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        assert self._server is not None
        self._server.close()
        for client in list(self.hub.clients):
            client.close()
        await self._server.wait_closed()
        await asyncio.sleep(0.02)

    def send(self, identifier: str, data: bytes) -> None:
        self.hub.publish(frame_text(identifier, time.time(), data), 1)

    def send_all(self, uptime_ms: int, tank: int = 3012) -> None:
        self.send("181", struct.pack("<4h", 3500, 3401, 3402, 3403))
        self.send("281", struct.pack("<4h", 3404, 3405, 3406, 3200))
        self.send("381", struct.pack("<hHI", tank, 0, uptime_ms))


@pytest.fixture
async def hub() -> AsyncIterator[Hub]:
    hub = Hub()
    await hub.start()
    yield hub
    await hub.stop()


def receiver(hub: Hub, points: tuple[Point, ...] = POINTS) -> CanReceiver:
    config = CanBus(transport="socketcand", port=hub.port, channel="vcan0", dbc=DBC, uptime="tc_uptime", timeout_s=0.5)
    return CanReceiver("thermocouples", config, points, time.monotonic)


async def connected(hub: Hub, points: tuple[Point, ...] = POINTS) -> CanReceiver:
    bus = receiver(hub, points)
    await bus.connect()
    while not hub.hub.listeners:
        await asyncio.sleep(0.01)
    return bus


async def settled(bus: CanReceiver, frames: int) -> None:
    for _ in range(200):
        if bus.frames >= frames:
            return
        await asyncio.sleep(0.01)
    pytest.fail(f"only {bus.frames} of {frames} frames came")


async def test_frames_become_values_with_the_modules_own_time(hub):
    bus = await connected(hub)
    hub.send_all(12_000)
    await bus.wait_for_device_time(12.0, 2.0)
    readings = await bus.read()
    await bus.close()
    by_name = dict(zip((p.name for p in POINTS), readings.values, strict=True))
    assert by_name["T_heater"] == pytest.approx(35.0)
    assert by_name["T_pm6"] == pytest.approx(34.06)
    assert by_name["T_tank"] == pytest.approx(30.12)
    assert set(readings.quality) == {Quality.GOOD}
    assert readings.source_time_s == pytest.approx([12.0] * len(POINTS), abs=0.1)


async def test_an_open_thermocouple_is_a_fault_and_not_327_degrees(hub):
    bus = await connected(hub)
    hub.send_all(1000, tank=0x7FFF)
    await bus.wait_for_device_time(1.0, 2.0)
    readings = await bus.read()
    await bus.close()
    quality = dict(zip((p.name for p in POINTS), readings.quality, strict=True))
    assert quality["T_tank"] == Quality.SENSOR_FAULT
    assert quality["T_heater"] == Quality.GOOD


async def test_silence_makes_values_stale_and_keeps_them_apart_from_good(hub):
    short = tuple(p.model_copy(update={"stale_after_s": 0.2}) for p in POINTS)
    bus = await connected(hub, short)
    hub.send_all(1000)
    await bus.wait_for_device_time(1.0, 2.0)
    await asyncio.sleep(0.3)
    readings = await bus.read()
    await bus.close()
    assert set(readings.quality) == {Quality.STALE}


async def test_nothing_received_is_nan_and_a_link_fault(hub):
    bus = await connected(hub)
    readings = await bus.read()
    await bus.close()
    assert all(math.isnan(value) for value in readings.values)
    assert set(readings.quality) == {Quality.LINK_FAULT}


async def test_unknown_extended_and_short_frames_are_counted_not_used(hub):
    bus = await connected(hub)
    hub.send("123", b"\x01")
    hub.send("00000181", struct.pack("<4h", 1, 2, 3, 4))
    hub.send("181", b"\x01\x02")
    hub.send_all(1000)
    await bus.wait_for_device_time(1.0, 2.0)
    readings = await bus.read()
    await bus.close()
    assert (bus.unknown_frames, bus.bad_frames) == (2, 1)
    assert readings.values[0] == pytest.approx(35.0)


async def test_a_hub_that_goes_away_is_noticed_and_comes_back(hub):
    short = tuple(p.model_copy(update={"stale_after_s": 0.3}) for p in POINTS)
    bus = await connected(hub, short)
    hub.send_all(1000)
    await bus.wait_for_device_time(1.0, 2.0)
    await hub.stop()
    await asyncio.sleep(0.6)
    gone = await bus.read()
    assert set(gone.quality) == {Quality.LINK_FAULT}
    assert "closed the connection" in (gone.fault or "") or "cannot be opened" in (gone.fault or "")
    await hub.start()
    back = time.monotonic()
    while not hub.hub.listeners:
        assert time.monotonic() - back < 2.5
        await asyncio.sleep(0.02)
    hub.send_all(9000)
    await bus.wait_for_device_time(9.0, 2.0)
    assert set((await bus.read()).quality) == {Quality.GOOD}
    assert bus.reconnects == 1
    await bus.close()


async def test_waiting_for_frames_that_never_come_ends_at_the_deadline(hub):
    bus = await connected(hub)
    with pytest.raises(LinkError, match=r"no frames of 5 s within 0\.1 s"):
        await bus.wait_for_device_time(5.0, 0.1)
    await bus.close()


async def test_bus_off_is_told_from_its_error_frame_and_gone_with_the_next_good_one(hub):
    points = tuple(point.model_copy(update={"stale_after_s": 0.1}) for point in POINTS)
    bus = await connected(hub, points)
    hub.send_all(1000)
    await settled(bus, 3)
    hub.hub.publish(b"< error 20000004 1.000000 >", 1)
    await settled(bus, 4)
    assert (await bus.read()).fault is None
    hub.hub.publish(b"< error 20000040 1.000000 >", 1)
    await settled(bus, 5)
    readings = await bus.read()
    assert "bus-off" in (readings.fault or "")
    await asyncio.sleep(0.2)
    assert set((await bus.read()).quality) == {Quality.LINK_FAULT}
    hub.send_all(2000)
    await settled(bus, 8)
    readings = await bus.read()
    assert readings.fault is None
    assert set(readings.quality) == {Quality.GOOD}
    assert (bus.error_frames, bus.reconnects) == (2, 0)
    await bus.close()


async def test_no_hub_at_all_is_said_at_once(hub):
    bus = receiver(hub)
    await hub.stop()
    began = time.monotonic()
    with pytest.raises(LinkError, match=r"cannot be opened.*is the rig on"):
        await bus.connect()
    assert time.monotonic() - began < 2.0
    await bus.close()
    await hub.start()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"message": "TC_X"}, "no message 'TC_X' for point T_heater; there is TC_A, TC_B, TC_C"),
        ({"signal": "T_heatre"}, "message TC_A has no signal 'T_heatre' for T_heater; it has T_heater"),
        ({"unit": "W"}, "signal T_heater is in degC, point T_heater in W"),
    ],
)
async def test_points_that_do_not_match_the_dbc_are_refused(hub, change, words):
    with pytest.raises(ConfigurationError) as caught:
        receiver(hub, (POINTS[0].model_copy(update=change),))
    assert words in str(caught.value)


async def test_a_missing_or_broken_dbc_is_refused(hub, tmp_path):
    broken = tmp_path / "x.dbc"
    broken.write_text("BO_ nonsense", encoding="utf-8")
    for path, words in ((tmp_path / "none.dbc", "no such DBC file"), (broken, "is not a DBC file")):
        config = CanBus(transport="socketcand", port=hub.port, channel="vcan0", dbc=path)
        with pytest.raises(ConfigurationError, match=words):
            CanReceiver("thermocouples", config, POINTS[:1], time.monotonic)


@settings(max_examples=400, deadline=None)
@given(
    identifier=st.sampled_from([0x181, 0x281, 0x381, 0x182]) | st.integers(0, 0x7FF),
    data=st.binary(max_size=8),
    extended=st.booleans(),
    remote=st.booleans(),
    error=st.booleans(),
)
def test_no_odd_frame_is_ever_a_wrong_value_that_counts_as_good(identifier, data, extended, remote, error):
    config = CanBus(transport="socketcand", port=1, channel="vcan0", dbc=DBC)
    bus = CanReceiver("thermocouples", config, POINTS, lambda: 1.0)
    bus._take(
        can.Message(
            arbitration_id=identifier,
            data=b"" if remote else data,
            dlc=len(data),
            is_extended_id=extended,
            is_remote_frame=remote,
            is_error_frame=error,
        )
    )
    layout = {0x181: "<4h", 0x281: "<4h", 0x381: "<hHI"}.get(identifier)
    usable = layout is not None and len(data) == 8 and not (extended or remote or error)
    raws = struct.unpack(layout, data) if usable else ()
    readings = asyncio.run(bus.read())
    for point, value, quality in zip(POINTS, readings.values, readings.quality, strict=True):
        if quality != Quality.GOOD:
            continue
        assert usable
        scale = 0.001 if point.name == "tc_uptime" else 1.0 if point.name == "tc_fault_bits" else 0.01
        assert any(value == pytest.approx(raw * scale) for raw in raws)
        assert point.plausible is None or point.plausible[0] <= value <= point.plausible[1]


def test_a_signal_that_comes_in_some_frames_only_does_not_end_the_receiving_thread(tmp_path):
    dbc = tmp_path / "mux.dbc"
    dbc.write_text(
        'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: N\n\nBO_ 256 M: 8 N\n'
        ' SG_ page M : 0|8@1+ (1,0) [0|1] "" N\n'
        ' SG_ T_a m0 : 8|16@1- (0.1,0) [-40|150] "degC" N\n'
        ' SG_ T_b m1 : 8|16@1- (0.1,0) [-40|150] "degC" N\n',
        encoding="utf-8",
    )
    points = tuple(Point(name=n, bus="c", unit="degC", message="M", signal=n) for n in ("T_a", "T_b"))
    bus = CanReceiver("c", CanBus(transport="socketcand", dbc=dbc), points, lambda: 1.0)
    bus._take(can.Message(arbitration_id=256, is_extended_id=False, data=struct.pack("<Bh5x", 1, 215)))
    readings = asyncio.run(bus.read())
    assert readings.values[1] == pytest.approx(21.5)
    assert readings.quality == [Quality.STALE, Quality.GOOD]
