"""What must hold on every Modbus transport, whatever the wire and the device do: no wrong value is ever good."""

from __future__ import annotations

import asyncio
import contextlib
import random
import time
from collections.abc import Callable, Coroutine

import pytest

from drivers.signals.points import DeviceExceptionError, DriverError, LinkError, Quality
from drivers.virtual.faults import faulty_replies as replies
from drivers.virtual.faults.faulty_link import Change
from hil.bench.faults.tls import Certificates
from tests.contract.wires import TIMEOUT_S, TRANSPORTS, wired

pytestmark = pytest.mark.parametrize("transport", TRANSPORTS)
Maker = Callable[[random.Random, float], Change]
PATIENT_S = 3.0
"""Deadline of a reply where none is missing: a busy machine pauses for longer than `TIMEOUT_S`."""


@pytest.fixture
def on(transport: str, certificates: Certificates | None):
    if transport == "tls" and certificates is None:
        pytest.skip("certificates are made by the openssl program, which is not installed")
    return lambda **changes: wired(transport, certificates, **changes)


def garbled(generator: random.Random, share: float) -> Change:
    return replies.garbled_header(generator, share)


async def test_values_are_right_read_after_read(on):
    async with on(timeout_s=PATIENT_S) as rig:
        for _ in range(30):
            assert set((await rig.read()).quality) == {Quality.GOOD}


async def test_writes_are_confirmed_and_read_back(on):
    async with on(timeout_s=PATIENT_S) as rig:
        await rig.bus.write({"set": 700, "beat": 7, "timeout": 90})
        assert rig.registers.holding[1:5] == [700, 0, 7, 90]
        assert await rig.bus.read_back(("set", "beat", "timeout")) == {"set": 700, "beat": 7, "timeout": 90}


async def test_function_23_writes_and_reads_back_in_one_request(on):
    async with on(read_write=True, timeout_s=PATIENT_S) as rig:
        seen: list[int] = []

        def note(frame: bytes) -> list[tuple[float, bytes]]:
            seen.append(frame[7])
            return [(0.0, frame)]

        rig.break_by(note)
        assert await rig.bus.write_and_read_back({"beat": 7}, ("beat", "timeout")) == {"beat": 7, "timeout": 100}
        assert seen == [23]
        held = await rig.bus.write_and_read_back({"set": 700, "timeout": 90}, ("set", "timeout"))
        assert held == {"set": 700, "timeout": 90}
        assert (seen[1:], rig.registers.holding[1:5]) == ([6, 23, 3], [700, 0, 7, 90])


async def test_a_device_without_function_23_is_asked_twice_from_then_on(on):
    async with on(read_write=True, timeout_s=PATIENT_S) as rig:
        seen: list[int] = []

        def none(frame: bytes) -> list[tuple[float, bytes]]:
            seen.append(frame[7] & 0x7F)
            return list(replies.refusal(random.Random(1), 1.0 if frame[7] == 23 else 0.0, 1)(frame))

        rig.break_by(none)
        for value in (80, 90):
            assert await rig.bus.write_and_read_back({"timeout": value}, ("timeout",)) == {"timeout": value}
        assert (seen, rig.registers.holding[4]) == ([23, 6, 3, 6, 3], 90)


async def test_a_late_reply_within_the_deadline_is_used(on):
    async with on(timeout_s=PATIENT_S) as rig:
        rig.break_by(replies.late(random.Random(1), 1.0, 0.03, 0.05), any_frame=True)
        for _ in range(3):
            assert set((await rig.read()).quality) == {Quality.GOOD}


async def test_a_reply_in_single_bytes_is_put_together(on):
    async with on(timeout_s=PATIENT_S) as rig:
        rig.break_by(replies.split_up(random.Random(1), 1.0), any_frame=True)
        for _ in range(5):
            assert set((await rig.read()).quality) == {Quality.GOOD}


FAULTS: dict[str, tuple[Maker, bool]] = {
    "a reply that does not come": (replies.swallowed, True),
    "a reply that is cut off": (replies.cut_off, True),
    "a reply of another function": (replies.wrong_function, False),
    "a reply with too few registers": (replies.too_few_registers, False),
    "a reply with other bits in its header": (garbled, True),
    "the reply before in front of this one": (replies.one_behind, True),
}


async def at_once(of_seed: Callable[[int], Coroutine[None, None, int]], *seeds: int) -> int:
    """Have connections, each with a seed of its own, wait at the same time; the sum of what they count."""
    async with asyncio.TaskGroup() as group:
        waiting = [group.create_task(of_seed(own)) for own in seeds]
    return sum(task.result() for task in waiting)


@pytest.mark.parametrize("fault", FAULTS)
async def test_a_fault_is_never_a_value_and_passes(on, fault):
    make, any_frame = FAULTS[fault]

    async def unused(seed: int) -> int:
        found = 0
        async with on() as rig:
            await rig.read()
            rig.break_by(make(random.Random(seed), 1.0), any_frame=any_frame)
            for _ in range(2):
                found += Quality.LINK_FAULT in (await rig.read()).quality
            rig.break_by(None)
            await rig.good_again(3.0)
        return found

    # A transaction tells the reply before from this one.
    assert await at_once(unused, 0, 1, 2, 3) or fault == "the reply before in front of this one"


@pytest.mark.parametrize("fault", FAULTS)
async def test_a_fault_never_confirms_a_write_that_is_read_back(on, fault):
    make, any_frame = FAULTS[fault]

    async def confirmed(seed: int) -> int:
        count = 0
        async with on(read_write=True) as rig:
            rig.break_by(make(random.Random(seed), 0.7), any_frame=any_frame)
            for beat in range(4 * seed, 4 * seed + 3):
                with contextlib.suppress(DriverError):
                    held = await rig.bus.write_and_read_back({"beat": beat}, ("beat", "timeout"))
                    assert held == {"beat": beat, "timeout": 100}
                    count += 1
            rig.break_by(None)
            await rig.good_again(3.0)
            assert await rig.bus.write_and_read_back({"beat": 77}, ("beat",)) == {"beat": 77}
            assert rig.registers.holding[3] == 77
        return count

    await at_once(confirmed, 0, 1, 2)


async def test_the_same_reply_twice_is_used_once_or_not_at_all(on):
    async with on() as rig:
        rig.break_by(replies.twice(random.Random(1), 0.5), any_frame=True)
        found = {quality for _ in range(8) for quality in (await rig.read()).quality}
        assert found <= {Quality.GOOD, Quality.LINK_FAULT}, "a reply was taken for something else"
        rig.break_by(None)
        await rig.good_again(3.0)


async def test_one_late_reply_never_shifts_the_next_answers(on):
    async def after_one(late_s: float) -> None:
        async with on() as rig:
            await rig.read()
            held = iter([[(late_s, None)]])

            def once(frame: bytes) -> list[tuple[float, bytes]]:
                for ((delay_s, _),) in held:
                    return [(delay_s, frame)]
                return [(0.0, frame)]

            rig.break_by(once, any_frame=True)
            assert Quality.LINK_FAULT in (await rig.read()).quality
            arrived = time.monotonic() + late_s + 2 * TIMEOUT_S
            in_a_row = 0
            while in_a_row < 5 or time.monotonic() < arrived:
                good = set((await rig.read()).quality) == {Quality.GOOD}
                in_a_row = in_a_row + 1 if good else 0
                assert time.monotonic() < arrived + 2.5, f"not good again after a reply that was {late_s:g} s late"
                await asyncio.sleep(0.02)

    async with asyncio.TaskGroup() as group:  # each with a connection of its own
        for late_s in (1.2 * TIMEOUT_S, 2.5 * TIMEOUT_S, 6 * TIMEOUT_S):
            group.create_task(after_one(late_s))


async def test_replies_that_are_late_again_and_again_are_never_wrong(on):
    async with on() as rig:
        rig.break_by(replies.late(random.Random(4), 0.3, 0.5 * TIMEOUT_S, 2.5 * TIMEOUT_S), any_frame=True)
        found = [(await rig.read()).quality for _ in range(25)]
        assert any(set(quality) == {Quality.GOOD} for quality in found), "no reply in time was used"
        assert any(Quality.LINK_FAULT in quality for quality in found), "no late reply was missed"
        rig.break_by(None)
        await rig.good_again(4.0)


async def test_a_refusal_is_an_error_with_its_code(on):
    async with on() as rig:
        for code in (1, 3, 4, 8, 11):
            rig.break_by(lambda frame, code=code: replies.refusal(random.Random(1), 1.0, code)(frame))
            with pytest.raises(DeviceExceptionError, match=f"exception {code}, ") as caught:
                await rig.bus.read_back(("set",))
            assert caught.value.code == code
            assert rig.bus.exceptions[code] >= 1
            assert Quality.GOOD not in (await rig.read()).quality
        rig.break_by(None)
        await rig.good_again(3.0)


async def test_a_busy_device_is_asked_again(on):
    async with on(timeout_s=PATIENT_S) as rig:
        left = [2]

        def busy(frame: bytes) -> list[tuple[float, bytes]]:
            left[0] -= 1
            return list(replies.refusal(random.Random(1), 1.0 if left[0] >= 0 else 0.0, 6)(frame))

        rig.break_by(busy)
        assert set((await rig.read()).quality) == {Quality.GOOD}
        assert rig.bus.exceptions[6] == 2


async def test_a_reset_is_noticed_at_once_and_over_within_two_seconds(on):
    async with on() as rig:
        await rig.read()
        rig.link.drop()
        began = time.monotonic()
        assert Quality.GOOD not in (await rig.read()).quality
        assert time.monotonic() - began < TIMEOUT_S + 1.0
        await asyncio.sleep(0.5)
        await rig.link.restore()
        await rig.good_again(2.0)


async def test_a_half_open_wire_is_noticed_within_its_deadline_and_comes_back(on):
    async with on() as rig:
        await rig.read()
        rig.link.mute()
        began = time.monotonic()
        assert Quality.GOOD not in (await rig.read()).quality
        assert time.monotonic() - began < TIMEOUT_S + 1.0
        with pytest.raises(LinkError):
            await rig.bus.write({"beat": 1})
        await asyncio.sleep(0.5)
        await rig.link.restore()
        await rig.good_again(2.5)


async def test_a_storm_of_faults_gives_no_wrong_value_and_nothing_foreign_is_raised(on):
    frame_faults = [replies.wrong_function, replies.too_few_registers]
    byte_faults = [replies.swallowed, replies.cut_off, garbled, replies.twice, replies.one_behind, replies.split_up]
    qualities: set[Quality] = set()

    async def storm(seed: int) -> int:
        generator = random.Random(seed)
        async with on(timeout_s=0.05) as rig:
            for number in range(20):
                pick = generator.randrange(len(frame_faults) + len(byte_faults) + 2)
                if pick < len(frame_faults):
                    rig.break_by(frame_faults[pick](generator, 0.7))
                elif pick < len(frame_faults) + len(byte_faults):
                    rig.break_by(byte_faults[pick - len(frame_faults)](generator, 0.7), any_frame=True)
                elif pick == len(frame_faults) + len(byte_faults):
                    rig.break_by(replies.late(generator, 0.5, 0.02, 0.12), any_frame=True)
                else:
                    rig.link.reset()
                qualities.update((await rig.read()).quality)
                if number % 10 == 0:
                    with contextlib.suppress(DriverError):
                        await rig.bus.write({"set": number, "beat": number + 1})
                await asyncio.sleep(0.005)
            rig.break_by(None)
            await rig.good_again(4.0)
        return 20

    assert await at_once(storm, 7, 8, 9) == 60
    assert {Quality.GOOD, Quality.LINK_FAULT} <= qualities, "the storms spared all reads, or none"


async def test_a_reply_that_comes_once_more_while_nothing_is_asked_is_not_the_next_answer(on):
    async with on(max_read=12, timeout_s=PATIENT_S) as rig:
        await rig.good_again(2.0)
        for _ in range(5):
            rig.break_by(lambda frame: [(0.0, frame), (0.004, frame)], any_frame=True)
            assert set((await rig.read()).quality) == {Quality.GOOD}
            rig.break_by(None)
            for _ in range(6):  # a turn of the loop for each hop, up to the serial line: a busy machine joins timers
                await asyncio.sleep(0.005)
            await rig.read()
        await rig.good_again(3.0)


async def test_what_a_caller_gives_up_on_does_not_shift_what_follows(on):
    async with on() as rig:
        rig.break_by(replies.late(random.Random(1), 1.0, 0.04, 0.05), any_frame=True)
        given_up = 0
        for _ in range(30):  # a busy machine lets a reply come in before the caller is told to give up
            try:
                async with asyncio.timeout(0.02):
                    await rig.read()
            except TimeoutError:
                given_up += 1
            if given_up == 3:
                break
            await asyncio.sleep(0.01)
        assert given_up == 3
        rig.break_by(None)
        for _ in range(10):
            await rig.read()
        await rig.good_again(2.0)
