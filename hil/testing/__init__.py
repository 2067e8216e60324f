"""Tests of a rig: plans with limits, and their verdicts on live and recorded runs.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.testing.bind import BoundLimit, RigSignals, bind
    from hil.testing.grammar import SentenceError, parse
    from hil.testing.judge import Judgement, judge_all
    from hil.testing.plan import Limit, Plan, TestPlanError, read_plan
    from hil.testing.recorded import judge_run
    from hil.testing.results import TestResult, junit, write_results
    from hil.testing.run_data import RunData
    from hil.testing.terminal import result_lines

__all__ = [
    "BoundLimit",
    "Judgement",
    "Limit",
    "Plan",
    "RigSignals",
    "RunData",
    "SentenceError",
    "TestPlanError",
    "TestResult",
    "bind",
    "judge_all",
    "judge_run",
    "junit",
    "parse",
    "read_plan",
    "result_lines",
    "write_results",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "bind": (
            "BoundLimit",
            "RigSignals",
            "bind",
        ),
        "grammar": (
            "SentenceError",
            "parse",
        ),
        "judge": (
            "Judgement",
            "judge_all",
        ),
        "plan": (
            "Limit",
            "Plan",
            "TestPlanError",
            "read_plan",
        ),
        "recorded": ("judge_run",),
        "results": (
            "TestResult",
            "junit",
            "write_results",
        ),
        "run_data": ("RunData",),
        "terminal": ("result_lines",),
    },
)
