"""How long a run was down: by the boot clock, by the wall clock, or as a person states it."""

from __future__ import annotations

import asyncio
import time

import pytest

from drivers.signals.points import ConfigurationError
from hil.run.restore import gap_evidence
from hil.run.restore.gap_evidence import LONG_GAP_S, ClockReading, clocks_recorded, duration_s, read_clocks, with_gap
from hil.run.restore.resumption import RunPosition
from hil.run_folder.folder import RunFolderError

NOW_S, UP_S = 1.8e9, 50_000.0
"""Wall clock and time since boot, as these tests have them."""
TEN_YEARS_S = 10 * 365.25 * 86400


@pytest.fixture
def clocks(monkeypatch):
    """The clocks of this machine, to be set."""

    class Clocks:
        wall_s, boot_s, boot_id, host = NOW_S, UP_S, "one", "bench"

    monkeypatch.setattr(gap_evidence.time, "time", lambda: Clocks.wall_s)
    monkeypatch.setattr(gap_evidence.time, "clock_gettime", lambda clock: Clocks.boot_s)
    monkeypatch.setattr(
        gap_evidence,
        "read_clocks",
        lambda: ClockReading(Clocks.boot_id, Clocks.host, Clocks.wall_s - Clocks.boot_s),
    )
    return Clocks


def cut(gap_s: float) -> RunPosition:
    """A run whose last row is `gap_s` old by the wall clock of that time."""
    return RunPosition(100, 100.0, NOW_S - gap_s, 100.0, "running", 2, 100, {})


def noted(boot_id: str = "one", host: str = "bench", up_s: float = UP_S) -> dict[str, object]:
    return {"boot_id": boot_id, "host": host, "wall_at_boot_s": NOW_S - up_s}


def found(was: RunPosition, note: object, stated_s: float | None = None) -> tuple[float, list[str]]:
    said: list[str] = []
    return with_gap(was, note, stated_s, said.append).gap_s(1.0), said


def test_within_a_boot_the_gap_is_that_of_the_boot_clock(clocks):
    assert found(cut(720.0), noted()) == (pytest.approx(720.0), [])


@pytest.mark.parametrize(("jump_s", "word"), [(TEN_YEARS_S, "3652 d forward"), (-3 * 86400.0, "3 d back")])
def test_a_wall_clock_that_was_set_within_a_boot_changes_no_gap_and_is_told(clocks, jump_s, word):
    clocks.wall_s += jump_s
    gap_s, said = found(cut(720.0), noted())
    assert gap_s == pytest.approx(720.0)
    assert len(said) == 1
    assert f"clock was set {word} since the cut; by its time since boot the gap is 12 min" in said[0]


@pytest.mark.parametrize("note", [None, noted("another"), noted(host="elsewhere"), {"boot_id": "one"}, "?"])
def test_without_the_boot_clock_the_wall_clock_is_believed_where_it_can_be_right(clocks, note):
    assert found(cut(UP_S + 720.0), note) == (pytest.approx(UP_S + 720.0), [])


@pytest.mark.parametrize("note", [None, noted("another"), noted(host="elsewhere")])
@pytest.mark.parametrize("gap_s", [TEN_YEARS_S, LONG_GAP_S + 1.0, -5.0, -TEN_YEARS_S])
def test_a_gap_that_cannot_be_or_hardly_is_one_is_questioned(clocks, note, gap_s):
    with pytest.raises(
        RunFolderError, match=r"by its clock the run was cut at .* state how long .* --gap 12min"
    ) as caught:
        found(cut(gap_s), note)
    assert len(str(caught.value).splitlines()) == 1
    assert found(cut(gap_s), note, 720.0) == (pytest.approx(720.0), [])


def test_a_gap_shorter_than_the_boot_that_ended_it_is_questioned(clocks):
    with pytest.raises(RunFolderError, match=r"a gap of 12 min, but the machine has been up for 13.89 h"):
        found(cut(720.0), noted("another"))
    assert found(cut(720.0), noted("another", host="elsewhere"))[0] == pytest.approx(720.0)


def test_a_row_stamped_after_now_within_a_boot_is_questioned(clocks):
    with pytest.raises(RunFolderError, match="which cannot be"):
        found(cut(-TEN_YEARS_S), noted())


def test_a_gap_of_more_than_a_week_is_questioned_whatever_the_clock(clocks):
    clocks.boot_s += LONG_GAP_S + 1000.0
    clocks.wall_s += LONG_GAP_S + 1000.0
    with pytest.raises(RunFolderError, match="longer than 7 d"):
        found(cut(0.0), noted())


def test_a_note_of_a_segment_that_never_had_a_row_is_no_evidence_of_the_one_before(clocks):
    """A resumed run that was killed before its first row: the note is of this boot, the row of one before."""
    assert found(cut(UP_S + 900.0), noted())[0] == pytest.approx(UP_S + 900.0)


def test_a_gap_counts_on_in_rig_time(clocks):
    was = with_gap(cut(720.0), noted(), None, lambda text: None)
    clocks.boot_s += 60.0
    assert was.gap_s(10.0) == pytest.approx(7800.0)


def test_a_jump_of_the_wall_clock_while_a_run_goes_on_is_noted(monkeypatch):
    monkeypatch.setattr(gap_evidence, "CHECK_EVERY_S", 0.01)
    kept: list[dict[str, object]] = []

    class Journal:
        def put_meta(self, key, value):
            assert key == "clock"
            kept.append(value)

    async def run() -> None:
        async with clocks_recorded(Journal()):
            await asyncio.sleep(0.05)
            assert len(kept) == 1
            real = time.time
            monkeypatch.setattr(gap_evidence.time, "time", lambda: real() + TEN_YEARS_S)
            await asyncio.sleep(0.1)

    now = read_clocks()
    if now is None:
        pytest.skip("no boot clock here")
    asyncio.run(run())
    assert len(kept) == 2
    assert kept[1]["wall_at_boot_s"] - kept[0]["wall_at_boot_s"] == pytest.approx(TEN_YEARS_S, abs=1.0)


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90.0), ("12min", 720.0), ("2.5 h", 9000.0), ("3d", 259200.0)])
def test_a_gap_is_stated_with_its_unit(text, seconds):
    assert duration_s(text) == seconds


@pytest.mark.parametrize("text", ["", "12", "-3h", "nan s", "1e3s", "12 minutes"])
def test_a_gap_that_is_none_is_refused(text):
    with pytest.raises(ConfigurationError, match=r"is no duration; write 90s, 12min, 2.5h or 3d"):
        duration_s(text)
