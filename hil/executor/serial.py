"""Executor in this process, one task after the other."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from typing import Any

from hil.executor.code_identity import code_identity
from hil.executor.contract import Answer, Hear, Task, TaskMessage
from hil.executor.task import perform

HERE = "this process"


class SerialExecutor:
    """Executor whose `submit` returns when the task is done."""

    def __init__(self, hear: Hear) -> None:
        self._hear, self._one = hear, threading.Lock()

    def slots(self) -> int:
        """Return 1."""
        return 1

    def submit(self, task: Task, given: Any, label: str) -> Future[Answer]:
        """Run a task, after those of other threads; its future is done."""
        future: Future[Answer] = Future()
        with self._one:
            self._hear(TaskMessage(label, HERE, "begins", begins=True))
            future.set_result(
                perform(task, given, lambda text: self._hear(TaskMessage(label, HERE, text)), HERE, code_identity())
            )
        return future

    def close(self) -> None:
        """Do nothing: there are no workers."""
