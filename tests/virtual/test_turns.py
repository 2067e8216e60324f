"""Processes that take turns share one processor, and have all of theirs back afterwards."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from drivers.virtual import taking_turns

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2, reason="one processor, or no affinities"
)


@pytest.fixture
def other() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        yield process
        process.kill()


def test_all_threads_and_the_other_process_share_one_processor(other: subprocess.Popen[bytes]) -> None:
    before = os.sched_getaffinity(0)
    asked, told = threading.Event(), []

    def work() -> None:
        asked.wait(60.0)
        told.append(os.sched_getaffinity(0))

    thread = threading.Thread(target=work)
    thread.start()
    with taking_turns([other.pid]):
        (one,) = os.sched_getaffinity(0)
        assert os.sched_getaffinity(other.pid) == {one}
        asked.set()
        thread.join()
    assert told == [{one}]
    assert os.sched_getaffinity(0) == os.sched_getaffinity(other.pid) == before


def test_a_process_that_has_ended_is_no_error(other: subprocess.Popen[bytes]) -> None:
    before = os.sched_getaffinity(0)
    other.kill()
    other.wait()
    with taking_turns([other.pid]):
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == before
