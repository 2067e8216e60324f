"""Processor time of a tick: parts add up to the loop's thread, and a run that is too short is refused."""

from __future__ import annotations

import threading

import pytest

from hil.bench.loop.processor_time import WARM_UP_TICKS, Counts, table


def test_a_run_within_the_warm_up_is_refused_with_a_remedy():
    counts = Counts()
    for _ in range(WARM_UP_TICKS):
        counts.tick()
    with pytest.raises(RuntimeError, match="run for longer"):
        table(counts)


def test_parts_before_the_end_of_the_warm_up_do_not_count():
    counts = Counts()
    counts.add("reads", 1.0)
    for _ in range(WARM_UP_TICKS + 1):
        counts.tick()
    counts.add("reads", 2.0)
    assert counts.parts == {"reads": 2.0}


def test_the_parts_and_the_rest_add_up_to_the_thread_of_the_loop():
    main = threading.main_thread().name
    counts = Counts(ticks=WARM_UP_TICKS + 11, parts={"reads": 0.02, "checks": 0.01}, process=0.06)
    counts.threads = {main: 0.05, "journal": 0.01}
    rows = {str(row[0]).strip(): row[1] for row in table(counts).rows}
    inner = rows["reads"] + rows["checks"] + rows["rest: event loop, clock, outcome"]
    assert inner == pytest.approx(rows["loop's thread"]) == pytest.approx(5.0)
    assert rows["process in all"] == pytest.approx(6.0) and rows["thread journal"] == pytest.approx(1.0)
