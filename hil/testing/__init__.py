"""Tests of a rig: plans with limits, and their verdicts on live and recorded runs.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.testing.bound_limits import BoundLimit, RigSignals, bind
    from hil.testing.judgement import Judgement, judge_all
    from hil.testing.live import LiveTest
    from hil.testing.matrix import Matrix, requirement_matrix
    from hil.testing.plan import Limit, Plan, TestPlanError, read_plan
    from hil.testing.prepared import PreparedTest, live_watch, prepared_test
    from hil.testing.recorded import judge_run
    from hil.testing.results import TestResult, is_wanted_trip, junit, write_results
    from hil.testing.run_data import RunData, read_run, root_mean_square
    from hil.testing.terminal import document_lines

__all__ = [
    "BoundLimit",
    "Judgement",
    "Limit",
    "LiveTest",
    "Matrix",
    "Plan",
    "PreparedTest",
    "RigSignals",
    "RunData",
    "TestPlanError",
    "TestResult",
    "bind",
    "document_lines",
    "is_wanted_trip",
    "judge_all",
    "judge_run",
    "junit",
    "live_watch",
    "prepared_test",
    "read_plan",
    "read_run",
    "requirement_matrix",
    "root_mean_square",
    "write_results",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "bound_limits": (
            "BoundLimit",
            "RigSignals",
            "bind",
        ),
        "judgement.judging": (
            "Judgement",
            "judge_all",
        ),
        "live": ("LiveTest",),
        "matrix": (
            "Matrix",
            "requirement_matrix",
        ),
        "plan": (
            "Limit",
            "Plan",
            "TestPlanError",
            "read_plan",
        ),
        "prepared": (
            "PreparedTest",
            "live_watch",
            "prepared_test",
        ),
        "recorded": ("judge_run",),
        "results": (
            "TestResult",
            "is_wanted_trip",
            "junit",
            "write_results",
        ),
        "run_data": (
            "RunData",
            "read_run",
            "root_mean_square",
        ),
        "terminal": ("document_lines",),
    },
)
