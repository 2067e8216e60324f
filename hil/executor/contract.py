"""Protocol of an executor, answers of its tasks, and its errors."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Protocol

Say = Callable[[str], None]
"""Callback for one line about the work."""
Task = Callable[[Any, Say], Any]
"""Function of a module that a worker can import: plain data and a callback in, plain data out."""


class ExecutorError(RuntimeError):
    """Error of an executor that cannot go on; the message is one plain sentence."""


class WorkerLostError(RuntimeError):
    """Error of a task whose workers ended while they ran it; another attempt may succeed."""


@dataclass(frozen=True, slots=True)
class TaskFailure:
    """Error of a task as data: its sentence, its traceback, and whether another attempt would end alike."""

    sentence: str
    trace: str
    is_final: bool


@dataclass(frozen=True, slots=True)
class Answer:
    """Answer of a task: its value or its failure.

    Attributes
    ----------
    value
        Return value of the task; None after a failure.
    failure
        Error of the task; None where it returned.
    worker, host
        Address of the worker and name of its machine.
    seconds, cpu_s
        Wall time of the task, and processor time of it and of the processes that it started and ended, s.
    """

    value: Any
    failure: TaskFailure | None
    worker: str
    host: str
    seconds: float
    cpu_s: float


@dataclass(frozen=True, slots=True)
class TaskMessage:
    """Message of a running task: its label, its worker, the text. `begins` marks the first one of an attempt."""

    label: str
    worker: str
    text: str
    begins: bool = False


Hear = Callable[[TaskMessage], None]
"""Callback for messages; it is called from another thread."""


class Executor(Protocol):
    """Executor of tasks on workers."""

    def slots(self) -> int:
        """Return how many tasks can run at a time now; 0 while no worker is connected."""

    def submit(self, task: Task, given: Any, label: str) -> Future[Answer]:
        """Hand a task to a worker.

        The future raises WorkerLostError for a task whose workers ended, and ExecutorError if the executor cannot go
        on. An error of the task itself is in its answer.

        Parameters
        ----------
        task
            Function of a module.
        given
            Plain data for it.
        label
            Name of the task in its messages, unique among those in progress.
        """

    def close(self) -> None:
        """End the executor and its own workers. Tasks in progress are given up: their futures raise ExecutorError."""
