"""What must hold on every CAN interface, whatever the module and the wire do: no wrong value is ever good."""

from __future__ import annotations

import asyncio
import math
import random
import struct

import pytest

from drivers.signals.points import Quality
from drivers.virtual.faults import faulty_replies as replies
from tests.contract.can_wires import INTERFACES, POINTS, SlcanSender, heard
from tests.drivers import j1939

pytestmark = pytest.mark.parametrize("transport", INTERFACES)
NAMES = [p.name for p in POINTS]


async def test_frames_become_values(transport):
    async with heard(transport) as rig:
        for number in range(1, 4):
            truth = rig.send_all()
            await rig.settled(3 * number)
            readings = await rig.bus.read()
            assert readings.values == pytest.approx(truth)
            assert set(readings.quality) == {Quality.GOOD}


async def test_frames_of_another_identifier_kind_or_length_are_counted_and_not_used(transport):
    async with heard(transport) as rig:
        rig.sender.send(0x182, struct.pack("<4h", 1, 2, 3, 4))
        rig.sender.send(0x181, struct.pack("<4h", 1, 2, 3, 4), extended=True)
        rig.sender.send(0x181, b"\1\2\3\4")
        rig.sender.send(0x381, b"")
        await rig.settled(4)
        readings = await rig.bus.read()
        assert Quality.GOOD not in readings.quality
        assert all(value != value for value in readings.values)
        assert (rig.bus.unknown_frames, rig.bus.bad_frames) == (2, 2)
        assert "with 0 bytes and is not used; thermocouples.dbc has it with 8" in (readings.fault or "")
        rig.sender.send_remote(0x181)
        await rig.good_again(2.0)
        assert rig.bus.error_frames == (0 if transport == "socketcand" else 1)


async def test_a_value_that_the_dbc_does_not_admit_is_out_of_range(transport):
    async with heard(transport) as rig:
        rig.send_all()
        await rig.settled(3)
        rig.sender.send(0x181, struct.pack("<4h", 15_001, 15_000, -4001, -4000))
        await rig.settled(4)
        quality = dict(zip(NAMES, (await rig.bus.read()).quality, strict=True))
        assert quality["T_heater"] == quality["T_pm2"] == Quality.OUT_OF_RANGE
        assert quality["T_pm1"] == quality["T_pm3"] == Quality.GOOD


async def test_silence_makes_values_stale(transport):
    async with heard(transport) as rig:
        rig.send_all()
        await rig.settled(3)
        await asyncio.sleep(0.35)
        assert set((await rig.bus.read()).quality) == {Quality.STALE}
        await rig.good_again(2.0)


async def test_an_open_thermocouple_is_a_sensor_fault(transport):
    async with heard(transport) as rig:
        rig.sender.send(0x381, struct.pack("<hHI", 0x7FFF, 256, 1000))
        await rig.settled(1)
        readings = await rig.bus.read()
        at = NAMES.index("T_tank")
        assert readings.quality[at] == Quality.SENSOR_FAULT
        assert readings.values[at] != readings.values[at]


async def test_frames_that_are_cut_garbled_or_lack_characters_are_never_wrong_values(transport):
    async with heard(transport) as rig:
        if transport == "virtual":
            pytest.skip("its frames are objects of one process")
        generator = random.Random(3)
        for number in range(12):
            if rig.link is not None:
                change = (replies.cut_off, replies.without_a_digit)[number % 2]
                rig.link.change = change(generator, 1.0)
                rig.send_all()
            else:
                assert isinstance(rig.sender, SlcanSender)
                line = b"t1818" + struct.pack("<4h", 7777, 7777, 7777, 7777).hex().upper().encode() + b"\r"
                cut = generator.randrange(1, len(line) - 1)
                rig.sender.say(line[:cut] + line[cut + generator.choice((1, 3)) :])
            await asyncio.sleep(0.03)
            readings = await rig.bus.read()
            for name, value, quality in zip(NAMES, readings.values, readings.quality, strict=True):
                if quality == Quality.GOOD and name.startswith("T_"):
                    assert rig.link is not None, f"{name} is {value} of a broken line"
        if rig.link is not None:
            rig.link.change = None
            rig.link.reset()
        await rig.good_again(5.0)


async def test_a_wire_that_is_reset_comes_back_by_itself(transport):
    async with heard(transport) as rig:
        if rig.link is None:
            pytest.skip("has no connection that could be reset")
        rig.send_all()
        await rig.settled(3)
        rig.link.drop()
        await asyncio.sleep(0.6)
        assert set((await rig.bus.read()).quality) == {Quality.LINK_FAULT}
        await rig.link.restore()
        await rig.good_again(3.0)
        assert rig.bus.reconnects >= 1


async def test_a_half_open_wire_makes_values_stale_and_comes_back(transport):
    async with heard(transport) as rig:
        if rig.link is None:
            pytest.skip("has no connection that could be half open")
        rig.send_all()
        await rig.settled(3)
        rig.link.mute()
        rig.send_all()
        await asyncio.sleep(0.4)
        assert Quality.GOOD not in (await rig.bus.read()).quality
        await rig.link.restore()
        await rig.good_again(4.0)


async def test_a_pgn_is_read_from_any_source_at_any_priority_and_no_other_frame(transport, tmp_path):
    async with heard(transport, j1939.POINTS, j1939.dbc_in(tmp_path)) as rig:
        for number, odd in enumerate((0x18FEEF00, 0x19FEEE00, 0x18FEED00), 1):
            rig.sender.send(odd, j1939.et1(70, 71), extended=True)
            await rig.settled(number)
        rig.sender.send(0x6EE, j1939.et1(70, 71))
        rig.sender.send(0x18FEEE00, j1939.et1(70, 71)[:4], extended=True)
        await rig.settled(5)
        assert Quality.GOOD not in (await rig.bus.read()).quality
        assert (rig.bus.unknown_frames, rig.bus.bad_frames) == (4, 1)
        for number, identifier in enumerate((0x18FEEE00, 0x0CFEEE00, 0x1CFEEE00), 6):
            rig.sender.send(identifier, j1939.et1(40 + number, 90), extended=True)
            await rig.settled(number)
            readings = await rig.bus.read()
            assert (readings.values, readings.fault) == ([40.0 + number, 90.0], None)
            assert set(readings.quality) == {Quality.GOOD}
        rig.sender.send(0x18FEEE00, b"\xff" + j1939.et1(0, 90)[1:], extended=True)
        await rig.settled(9)
        assert (await rig.bus.read()).quality == [Quality.SENSOR_FAULT, Quality.GOOD]
        await asyncio.sleep(0.35)
        assert set((await rig.bus.read()).quality) == {Quality.STALE}


async def test_two_sources_of_one_pgn_are_refused_and_a_source_picks_one(transport, tmp_path):
    dbc = j1939.dbc_in(tmp_path)
    async with heard(transport, j1939.POINTS, dbc) as rig:
        rig.sender.send(0x18FEEE00, j1939.et1(70, 71), extended=True)
        await rig.settled(1)
        assert (await rig.bus.read()).values == [70.0, 71.0]
        rig.sender.send(0x18FEEE03, j1939.et1(20, 21), extended=True)
        rig.sender.send(0x18FEEE00, j1939.et1(72, 73), extended=True)
        await rig.settled(3)
        readings = await rig.bus.read()
        assert all(math.isnan(value) for value in readings.values)
        assert set(readings.quality) == {Quality.LINK_FAULT}
        assert "ET1 comes from source = 0x00 and source = 0x03, and is not used" in (readings.fault or "")
    one = ({"name": "ET1", "pgn": 0xFEEE, "source": 3},)
    async with heard(transport, j1939.POINTS, dbc, message=one) as rig:
        for number in range(1, 4):
            rig.sender.send(0x18FEEE00, j1939.et1(70, 71), extended=True)
            rig.sender.send(0x18FEEE03, j1939.et1(20, 21), extended=True)
            await rig.settled(2 * number)
            readings = await rig.bus.read()
            assert (readings.values, set(readings.quality)) == ([20.0, 21.0], {Quality.GOOD})


async def test_an_id_with_a_mask_is_read_in_the_bits_of_the_mask(transport, tmp_path):
    entry = ({"name": "ET1", "id": 0x300, "mask": 0x7F0, "extended": False},)
    async with heard(transport, j1939.POINTS, j1939.dbc_in(tmp_path), message=entry) as rig:
        rig.sender.send(0x314, j1939.et1(20, 21))
        rig.sender.send(0x304, j1939.et1(20, 21), extended=True)
        await rig.settled(2)
        assert Quality.GOOD not in (await rig.bus.read()).quality
        rig.sender.send(0x304, j1939.et1(70, 71))
        await rig.settled(3)
        readings = await rig.bus.read()
        assert (readings.values, set(readings.quality)) == ([70.0, 71.0], {Quality.GOOD})
