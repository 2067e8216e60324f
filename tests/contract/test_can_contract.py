"""What must hold on every CAN interface, whatever the module and the wire do: no wrong value is ever good."""

from __future__ import annotations

import asyncio
import random
import struct

import pytest

from drivers.points import Quality
from drivers.virtual import faulty_replies as replies
from tests.contract.can_wires import INTERFACES, POINTS, SlcanSender, heard

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
