"""Ticks in real time: a tick that was overslept is left out, and time goes on while the machine is suspended."""

from __future__ import annotations

import pytest

import hil.run.engine.clock
from hil.run.engine.clock import MonotonicClock


class Sleeper:
    """A steady clock by hand; each sleep takes as long as was asked and what `oversleeps` adds, in turn."""

    def __init__(self, *oversleeps: float) -> None:
        self.now = 500.0
        self.oversleeps = list(oversleeps)

    async def sleep(self, seconds: float) -> None:
        self.now += seconds + (self.oversleeps.pop(0) if self.oversleeps else 0.0)


@pytest.fixture
def sleeper(monkeypatch: pytest.MonkeyPatch) -> Sleeper:
    sleeper = Sleeper()
    monkeypatch.setattr(hil.run.engine.clock, "steady_s", lambda: sleeper.now)
    monkeypatch.setattr(hil.run.engine.clock.asyncio, "sleep", sleeper.sleep)
    return sleeper


async def ticks(clock: MonotonicClock, count: int) -> list[int]:
    return [await clock.next_tick() for _ in range(count)]


async def test_ticks_follow_one_another_while_none_is_missed(sleeper):
    clock = MonotonicClock(0.1)
    await clock.start()
    assert await ticks(clock, 4) == [0, 1, 2, 3]
    assert clock.overruns == 0


@pytest.mark.parametrize("speed", [1.0, 20.0])
async def test_a_tick_that_was_overslept_has_the_time_of_what_is_read_then(sleeper, speed):
    clock = MonotonicClock(1.0, speed)
    await clock.start()
    sleeper.oversleeps = [0.0, 0.0, 6.4 / speed]
    assert await ticks(clock, 5) == [0, 1, 8, 9, 10]
    assert clock.overruns == 1


async def test_a_sleep_that_is_a_little_too_long_leaves_no_tick_out(sleeper):
    clock = MonotonicClock(1.0)
    await clock.start()
    sleeper.oversleeps = [0.9, 0.0, 0.3]
    assert await ticks(clock, 4) == [0, 1, 2, 3]
    assert clock.overruns == 0


async def test_work_that_takes_longer_than_a_period_leaves_ticks_out(sleeper):
    clock = MonotonicClock(1.0)
    await clock.start()
    await clock.next_tick()
    sleeper.now += 3.5
    assert await clock.next_tick() == 3
    assert clock.overruns == 1
