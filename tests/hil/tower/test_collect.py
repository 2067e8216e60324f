"""`hil tower collect`: a rig's points, polled into a historian with time and quality."""

from __future__ import annotations

import asyncio
import math
import time
from pathlib import Path
from typing import Any

import pytest

from drivers.historian import HistorianAwayError, HistorianError, Samples, open_store
from drivers.rig_file.reader import load_rig
from drivers.signals.points import LinkError, Quality, Snapshot
from hil.tower.station import collection as module
from hil.tower.station.collection import CODES, Collected, collect

RIG = load_rig(Path(__file__).resolve().parents[3] / "profiles" / "rigs" / "virtual.toml")


class _Connection:
    """What the collection sees of a rig: one point of each quality, and failures on demand."""

    failing: tuple[int, ...] = ()

    def __init__(self, rig: Any, clock: Any) -> None:
        self.points = tuple(rig.point[:5])
        self.polls = 0

    async def connect(self) -> None: ...

    async def close(self) -> None: ...

    async def read(self) -> Snapshot:
        self.polls += 1
        if self.polls in self.failing:
            raise LinkError("no answer")
        return Snapshot([1.0, 2.0, 3.0, 4.0, math.nan], [int(q) for q in Quality], [0.0] * 5)


@pytest.fixture(autouse=True)
def _rig(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RigConnection", _Connection)


def _clock() -> Any:
    ticks = iter(range(1_700_000_000, 1_800_000_000, 60))
    return lambda: float(next(ticks))


def test_readings_are_stored_with_their_time_and_quality(tmp_path: Path) -> None:
    with open_store(tmp_path / "s", create=True) as store:
        done = asyncio.run(collect(RIG, store, every_s=0.02, minutes=0.1 / 60, now=_clock()))
        read = store.read([point.name for point in RIG.point[:5]])
    assert done.polls >= 2 and done.samples == 5 * done.polls and done.failures == 0
    for point, quality in zip(RIG.point[:5], Quality, strict=True):
        assert set(read[point.name].quality) == {CODES[quality]}
        assert read[point.name].time_s[:2].tolist() == [1.7e9, 1.7e9 + 60.0]
    assert CODES[Quality.GOOD] == 192 and CODES[Quality.STALE] == 64 and CODES[Quality.LINK_FAULT] == 0


def test_a_poll_that_failed_is_a_bad_sample_and_not_a_value(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_Connection, "failing", (2,))
    with open_store(tmp_path / "s", create=True) as store:
        done = asyncio.run(collect(RIG, store, every_s=0.02, minutes=0.1 / 60, now=_clock()))
        first = store.read([RIG.point[0].name])[RIG.point[0].name]
    assert done.failures == 1 and done.last_failure == "no answer"
    assert first.quality[:3].tolist() == [192, 0, 192] and math.isnan(first.value[1])


def test_what_was_collected_is_stored_when_it_is_interrupted(tmp_path: Path) -> None:
    async def interrupted(store: Any) -> None:
        task = asyncio.create_task(collect(RIG, store, every_s=0.02, minutes=None, now=_clock()))
        await asyncio.sleep(0.2)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    with open_store(tmp_path / "s", create=True) as store:
        asyncio.run(interrupted(store))
        assert len(store.read([RIG.point[0].name])[RIG.point[0].name]) >= 2


def test_a_store_that_fails_ends_the_collection_with_its_sentence(tmp_path: Path) -> None:
    class Full:
        def append(self, samples: dict[str, Samples]) -> None:
            raise HistorianError("the disk is full; make room")

    with pytest.raises(HistorianError, match="the disk is full"):
        asyncio.run(collect(RIG, Full(), every_s=0.02, minutes=0.1 / 60))  # type: ignore[arg-type]


def test_a_connection_that_fails_to_close_loses_no_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(self: _Connection) -> None:
        raise LinkError("the socket is gone")

    monkeypatch.setattr(_Connection, "close", broken)
    with open_store(tmp_path / "s", create=True) as store:
        with pytest.raises(LinkError, match="the socket is gone"):
            asyncio.run(collect(RIG, store, every_s=0.02, minutes=0.1 / 60, now=_clock()))
        assert len(store.read([RIG.point[0].name])[RIG.point[0].name]) >= 2


def test_progress_counts_polls(tmp_path: Path) -> None:
    seen: list[int] = []

    def note(done: Collected) -> None:
        seen.append(done.polls)

    with open_store(tmp_path / "s", create=True) as store:
        asyncio.run(collect(RIG, store, every_s=0.02, minutes=0.1 / 60, progress=note))
    assert seen == list(range(1, len(seen) + 1)) and seen


def test_a_store_that_is_away_delays_no_poll_and_loses_no_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FLUSH_S", 0.05)

    class Away:
        """A store that blocks and then stays away in its first three calls."""

        calls = 0
        times: tuple[float, ...] = ()
        polled: tuple[int, ...] = ()

        def append(self, samples: dict[str, Samples]) -> None:
            self.calls += 1
            if self.calls <= 3:
                before = len(seen)
                time.sleep(0.2)
                self.polled += (len(seen) - before,)
                raise HistorianAwayError("went away")
            self.times += tuple(samples[RIG.point[0].name].time_s)

    seen: list[int] = []
    store = Away()
    length = {"every_s": 0.02, "minutes": 1.5 / 60}
    done = asyncio.run(
        collect(RIG, store, **length, now=_clock(), progress=lambda d: seen.append(d.polls))  # type: ignore[arg-type]
    )
    assert done.away == 3 and done.samples == 5 * done.polls
    assert min(store.polled) > 0
    assert list(store.times) == sorted(store.times) and len(store.times) == done.polls


def test_a_store_that_is_away_for_too_long_ends_the_collection(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FLUSH_S", 0.02)
    monkeypatch.setattr(module, "MOST_WAITING", 40)

    class Away:
        def append(self, samples: dict[str, Samples]) -> None:
            raise HistorianAwayError("went away")

    with pytest.raises(HistorianAwayError, match="went away"):
        asyncio.run(collect(RIG, Away(), every_s=0.005, minutes=10.0 / 60))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("read", "stamps"),
    [
        ([100, 101, 4e9, 4e9, 104, 105], [100, 101, 102, 103, 104, 105]),
        ([100, 101, -2e6, 103], [100, 101, 102, 103]),
        ([100, 7300, 7301], [100, 7300, 7301]),
        ([3e6, 3e6 + 1, 2, 3, 4], [3e6, 3e6 + 1, 3e6 + 2, 3, 4]),
        ([100, 36100, 72100, 4e9, 144100], [100, 36100, 72100, 108100, 144100]),
    ],
)
def test_a_calendar_that_was_read_wrongly_moves_no_sample(read: list[float], stamps: list[float]) -> None:
    calendar, zero = module._Calendar(), 1.7e9
    found = [calendar.at(1.8e9 + k, zero + one) - zero for k, one in enumerate(read)]
    assert found == pytest.approx(stamps, abs=1e-3)
