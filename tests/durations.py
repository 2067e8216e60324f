"""Measured durations of tests: slow ones are marked, and their files are handed out first.

`tests/durations.txt` has a line for every test function that takes long: seconds on two quiet cores, all of its
parameters and fixtures together, and its name. `pytest -n 3 --write-durations` measures them anew.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest

FILE = Path(__file__).with_name("durations.txt")
SLOW_S = 1.0
"""Least duration of a slow test function: the quicker ones, five of six, together take under two minutes."""


def read() -> dict[str, float]:
    """Return test function -> seconds, from `durations.txt`."""
    rows = (line.split(maxsplit=1) for line in FILE.read_text(encoding="utf-8").splitlines())
    return {name: float(seconds) for seconds, name in rows}


def write(reports: Iterable[pytest.TestReport]) -> None:
    """Write the durations of the slow test functions among the reports of a session."""
    total: dict[str, float] = defaultdict(float)
    for report in reports:
        total[_function(report.nodeid)] += report.duration
    slow = sorted(((seconds, name) for name, seconds in total.items() if seconds >= SLOW_S), reverse=True)
    FILE.write_text("".join(f"{seconds:.1f} {name}\n" for seconds, name in slow), encoding="utf-8")


def mark_and_order(items: list[pytest.Item], known: Mapping[str, float]) -> None:
    """Mark slow tests, and put the files that take longest first, so that no worker ends on a long one alone."""
    files: dict[str, float] = defaultdict(float)
    for name, seconds in known.items():
        files[name.partition("::")[0]] += seconds
    for item in items:
        if _function(item.nodeid) in known:
            item.add_marker(pytest.mark.slow)
    items.sort(key=lambda item: -files[item.nodeid.partition("::")[0]])


def _function(nodeid: str) -> str:
    return nodeid.partition("[")[0]
