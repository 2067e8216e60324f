"""Tasks on worker processes, here or elsewhere.

The names below are the package's interface; they are loaded on first use. Other modules are private to the package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.lazy_names import lazy_names

if TYPE_CHECKING:
    from hil.executor.asking import TaskError, ask, in_parallel
    from hil.executor.contract import (
        Answer,
        Executor,
        ExecutorError,
        Hear,
        Say,
        Task,
        TaskFailure,
        TaskMessage,
        WorkerLostError,
    )
    from hil.executor.opening import LOCAL, SERIAL, ExecutorOptionError, ExecutorOptions, check_options, opened

__all__ = [
    "LOCAL",
    "SERIAL",
    "Answer",
    "Executor",
    "ExecutorError",
    "ExecutorOptionError",
    "ExecutorOptions",
    "Hear",
    "Say",
    "Task",
    "TaskError",
    "TaskFailure",
    "TaskMessage",
    "WorkerLostError",
    "ask",
    "check_options",
    "in_parallel",
    "opened",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "asking": ("TaskError", "ask", "in_parallel"),
        "contract": (
            "Answer",
            "Executor",
            "ExecutorError",
            "Hear",
            "Say",
            "Task",
            "TaskFailure",
            "TaskMessage",
            "WorkerLostError",
        ),
        "opening": ("ExecutorOptionError", "ExecutorOptions", "LOCAL", "SERIAL", "check_options", "opened"),
    },
)
