"""One task on a worker: check of the versions, messages, errors as data."""

from __future__ import annotations

import os
import platform
import time
import traceback
from typing import Any

from hil.errors import exhausted_resource, exit_code
from hil.executor.code_identity import CodeIdentity, code_identity
from hil.executor.contract import Answer, Say, Task, TaskFailure


class OtherVersionError(RuntimeError):
    """Error of a worker whose code differs from the client's; the message is one plain sentence."""


def perform(task: Task, given: Any, say: Say, worker: str, wanted: CodeIdentity) -> Answer:
    """Run a task and return its answer; an error of it is part of the answer.

    Parameters
    ----------
    task, given
        Function and its data.
    say
        Callback for the lines that the task reports.
    worker
        Address of this worker.
    wanted
        Identity of the client's code.

    Raises
    ------
    OtherVersionError
        This worker has other code.
    """
    difference = wanted.difference(code_identity())
    if difference:
        raise OtherVersionError(sentence_of(worker, difference))
    began, used = time.monotonic(), _processor_s()
    value, failure = None, None
    try:
        value = task(given, say)
    except Exception as error:
        said = str(error).strip() or type(error).__name__
        known = exit_code(error) is not None
        if not known:
            said = exhausted_resource(error) or f"{type(error).__name__}: {said}"
        failure = TaskFailure(said, traceback.format_exc(), known)
    seconds, cpu_s = time.monotonic() - began, _processor_s() - used
    return Answer(value, failure, worker, platform.node(), seconds, cpu_s)


def _processor_s() -> float:
    """Return the processor time of this process and of its ended children, s."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def sentence_of(worker: str, difference: str) -> str:
    """Return the sentence on a worker of other code."""
    return f"the worker {worker} has {difference}; install the same version there, and give the same command again"
