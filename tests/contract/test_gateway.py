"""A gateway from TCP to a serial line that is one reply behind: under the right transaction, so no frame shows it."""

from __future__ import annotations

import asyncio

import pytest

from drivers.signals.points import Quality
from tests.contract.wires import wired


class OneBehind:
    """Answers the first request with exception 11, and from then on each with the reply to the one before.

    After `until` replies its queue is emptied, as by whoever restarts it.
    """

    def __init__(self, until: int) -> None:
        self._left = until
        self._before: bytes | None = None

    def __call__(self, frame: bytes) -> list[tuple[float, bytes]]:
        if self._left <= 0:
            return [(0.0, frame)]
        self._left -= 1
        before, self._before = self._before, frame[6:]
        if before is None:
            before = frame[6:7] + bytes((frame[7] | 0x80, 11))
        return [(0.0, frame[:4] + len(before).to_bytes(2, "big") + before)]


async def test_a_gateway_that_is_a_reply_behind_is_found_out_where_the_rig_file_says_that_it_is_one():
    async with wired("tcp", None, serial_baud=19200) as rig:
        rig.break_by(OneBehind(25))
        good = 0
        for _ in range(20):
            good += Quality.GOOD in (await rig.read()).quality
            await asyncio.sleep(0.005)
        await rig.good_again(3.0)
    assert good < 20


async def test_without_that_its_values_are_those_of_the_request_before():
    async with wired("tcp", None) as rig:
        rig.break_by(OneBehind(25))
        with pytest.raises(AssertionError, match=r"is \d+.0 and was \d+"):
            await rig.good_again(3.0)
