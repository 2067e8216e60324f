"""Session of a run from its request to its folder.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.run.session.event_loop import session_result
    from hil.run.session.interrupted_run import request_of, resume_notices
    from hil.run.session.regenerate import current_record, judge_recorded, regenerate_files
    from hil.run.session.request import RunRequest, check_calibrators, chosen_calibrators, setpoint_limits
    from hil.run.session.run import RunResult
    from hil.run.session.session import check_session, resume_session, run_session
    from hil.run.session.terminal import ProgressBar, RunProgress, console, hours, invocation, show_comparison

__all__ = [
    "ProgressBar",
    "RunProgress",
    "RunRequest",
    "RunResult",
    "check_calibrators",
    "check_session",
    "chosen_calibrators",
    "console",
    "current_record",
    "hours",
    "invocation",
    "judge_recorded",
    "regenerate_files",
    "request_of",
    "resume_notices",
    "resume_session",
    "run_session",
    "session_result",
    "setpoint_limits",
    "show_comparison",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "event_loop": ("session_result",),
        "interrupted_run": (
            "request_of",
            "resume_notices",
        ),
        "regenerate": (
            "current_record",
            "judge_recorded",
            "regenerate_files",
        ),
        "request": (
            "RunRequest",
            "check_calibrators",
            "chosen_calibrators",
            "setpoint_limits",
        ),
        "run": ("RunResult",),
        "session": (
            "check_session",
            "resume_session",
            "run_session",
        ),
        "terminal": (
            "ProgressBar",
            "RunProgress",
            "console",
            "hours",
            "invocation",
            "show_comparison",
        ),
    },
)
