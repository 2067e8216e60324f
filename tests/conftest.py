"""Fixtures for all tests: no test may leave tasks behind, and data that is not shipped is found or skipped."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before the first import of numpy, which reads it once

import asyncio
import gc
import logging
import signal
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import pytest_asyncio

from tests import durations, same_questions

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell starts what runs in its background deaf to Ctrl-C, and so would be every process that a test interrupts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
    signal.signal(signal.SIGHUP, lambda *_: None)  # the same of nohup: a started process has the default again

# How long one example takes is a matter of the machine, and no test asserts it. HIL_EXAMPLES=1000 looks further.
hypothesis.settings.register_profile("hil", deadline=None, max_examples=int(os.environ.get("HIL_EXAMPLES", "50")))
hypothesis.settings.load_profile("hil")

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def _asynchronous(request: pytest.FixtureRequest) -> None:
    """Have the tasks of an async test looked after; an event loop for every other test would cost seconds."""
    if asyncio.iscoroutinefunction(getattr(request, "function", None)):
        request.getfixturevalue("_no_leaked_tasks")


@pytest_asyncio.fixture
async def _no_leaked_tasks() -> AsyncIterator[None]:
    """Fail any async test that leaves tasks running."""
    yield
    await asyncio.sleep(0)
    left = [task for task in asyncio.all_tasks() if task is not asyncio.current_task() and not task.done()]
    for task in left:
        task.cancel()
    if left:
        await asyncio.gather(*left, return_exceptions=True)
        pytest.fail("tasks left behind: " + ", ".join(task.get_name() for task in left))


@pytest.fixture(autouse=True)
def _process_as_before() -> Iterator[None]:
    """Fail any test that leaves this process as a command leaves one that ends with it.

    Every process that a later test starts would inherit an ignored Ctrl-C.
    """
    yield
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        pytest.fail("the test left SIGINT ignored in this process")
    if logging.getLogger("asyncio").disabled:
        logging.getLogger("asyncio").disabled = False
        pytest.fail("the test left the log of asyncio disabled in this process")


@pytest.fixture(scope="session", autouse=True)
def _same_question_is_searched_once() -> Iterator[None]:
    """Search once for what commands ask of the same twin, record and healthy record, and learn once from the latter.

    Both depend on nothing else, and their results are frozen, as are pictures of the same curves. Tests of the search
    and of the figures themselves call them directly.
    """
    with pytest.MonkeyPatch.context() as patch:
        same_questions.remember(patch)
        yield


@pytest.fixture(scope="session")
def hil_data() -> Path:
    """Folder of recordings that are not part of the project (environment variable HIL_DATA)."""
    folder = Path(os.environ.get("HIL_DATA", PROJECT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set HIL_DATA to their folder")
    return folder


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of single folders, which pytest takes from here only."""
    parser.addoption("--contract-table", help="write the table of tests/contract, transport by test, to this file")
    parser.addoption("--write-durations", action="store_true", help="measure tests/durations.txt anew")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow tests and begin with their files."""
    durations.mark_and_order(items, durations.read())


def pytest_collection_finish() -> None:
    """Leave modules and collected tests out of every later garbage collection, and collect less often."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, *gc.get_threshold()[1:])


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Write the durations that were measured, where that was asked for."""
    if config.getoption("--write-durations"):
        durations.write(r for found in terminalreporter.stats.values() for r in found if hasattr(r, "duration"))
