"""Answer of one task, which starts again where its worker is lost."""

from __future__ import annotations

from typing import Any

from hil.executor.contract import Executor, Task, WorkerLostError

ATTEMPTS = 3
"""Most starts of a task whose workers are lost."""


class TaskError(RuntimeError):
    """Error of a task on a worker; the message is its sentence."""


def ask(executor: Executor, task: Task, given: Any, label: str) -> Any:
    """Return the value of a task; wait for it.

    Parameters
    ----------
    executor
        Executor of the task.
    task, given, label
        As `Executor.submit` takes them.

    Raises
    ------
    TaskError
        The task raised an error.
    WorkerLostError
        Its workers ended while they ran it, `ATTEMPTS` times.
    ExecutorError
        The executor cannot go on.
    """
    for attempt in range(1, ATTEMPTS + 1):
        try:
            found = executor.submit(task, given, label).result()
        except WorkerLostError:
            if attempt == ATTEMPTS:
                raise
            continue
        if found.failure is not None:
            raise TaskError(found.failure.sentence)
        return found.value
    raise AssertionError
