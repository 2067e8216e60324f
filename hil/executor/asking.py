"""Answer of one task, which starts again where its worker is lost, and jobs of several tasks in parallel."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from hil.executor.contract import Executor, Task, WorkerLostError

Job = TypeVar("Job")
Result = TypeVar("Result")

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


def in_parallel(
    executor: Executor,
    jobs: Sequence[Job],
    run: Callable[[Job], Result],
    heard: Callable[[float, Result], None],
    at_once: int | None = None,
) -> list[Result]:
    """Run jobs that wait for tasks of an executor; return their results in the order of the jobs.

    Parameters
    ----------
    executor
        Executor whose tasks `run` waits for.
    jobs
        What `run` gets, one by one.
    run
        Function of one job; it is called on a thread.
    heard
        Function that gets the share of jobs that are done, and the last result, one call at a time.
    at_once
        Jobs at a time; None takes as many as workers are connected.
    """
    lock, done = threading.Lock(), 0

    def run_one(job: Job) -> Result:
        nonlocal done
        result = run(job)
        with lock:
            done += 1
            heard(done / len(jobs), result)
        return result

    with ThreadPoolExecutor(at_once or max(executor.slots(), 1)) as pool:
        return list(pool.map(run_one, jobs))
