"""Session of a fleet: jobs that are left, attempts, cancellation."""

from __future__ import annotations

import contextlib
import datetime
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil import __version__
from hil.executor import (
    Answer,
    Executor,
    ExecutorOptions,
    TaskMessage,
    WorkerLostError,
    check_options,
    opened,
)
from hil.fleet.fleet_file import Fleet, FleetError
from hil.fleet.folder import FleetFolder, FleetFolderError
from hil.fleet.jobs import Job
from hil.fleet.kinds import GivenJob, MadeJob, perform_job
from hil.fleet.table import write_table

POLL_S = 0.5
"""Time after which the request to cancel is read again, s."""
MOST_AHEAD = 8
"""Most jobs beyond one a worker that are handed out, so that no worker waits for the next record. The scheduler holds
the files of all jobs that are handed out."""
NOTICE_S = 30.0
"""Time between two notices that no worker is connected, s."""

Progress = Callable[[int, str], None]
"""Callback with the number of finished jobs and a note."""


@dataclass(frozen=True, slots=True)
class FleetOutcome:
    """Outcome of a session: the results of its jobs by id, and whether it was cancelled."""

    results: dict[str, dict[str, Any]]
    cancelled: bool

    @property
    def failed(self) -> list[str]:
        """Return the ids of the jobs that failed."""
        return [name for name, result in self.results.items() if result["status"] == "failed"]


@dataclass(frozen=True, slots=True)
class FleetRequest:
    """Request of a session: fleet file, its jobs, folder, executor, and whether failed jobs run again."""

    fleet: Fleet
    jobs: tuple[Job, ...]
    out: Path
    executor: ExecutorOptions
    retry: bool = False


def run_fleet(request: FleetRequest, progress: Progress, note: Callable[[str], None]) -> FleetOutcome:
    """Run the jobs of a fleet that have no result yet; Ctrl-C and a request in the folder cancel what is left.

    Parameters
    ----------
    request
        What to run, where, and on which workers.
    progress
        Called when a job is finished.
    note
        Called with sentences for the operator.

    Raises
    ------
    FleetError, ExecutorOptionError
        A file, the folder or an option is wrong.
    ExecutorError, FleetFolderError
        The workers or the folder cannot be used any more. Finished jobs are kept.
    """
    check_options(request.executor)
    jobs = request.jobs
    folder = FleetFolder(request.out)
    with folder.held(request.fleet):
        results = known_results(folder, jobs)
        if request.retry:
            for job in [name for name, result in results.items() if result["status"] == "failed"]:
                folder.forget(job)
                del results[job]
        session = _Session(request.fleet.attempts, folder, jobs, results, progress, note)
        cancelled = False
        if session.left:
            try:
                with opened(request.executor, session.hear) as executor:
                    cancelled = session.work(executor)
            except KeyboardInterrupt:
                cancelled = True
            finally:
                write_table(folder, jobs, results)
        else:
            write_table(folder, jobs, results)
    return FleetOutcome(results, cancelled)


def known_results(folder: FleetFolder, jobs: tuple[Job, ...]) -> dict[str, dict[str, Any]]:
    """Return the results that a folder has of some jobs, by their ids; raises FleetError for a damaged one."""
    return {job.id: result for job in jobs if (result := folder.result(job.id)) is not None}


class _Session:
    """State of a session; `results` is filled as jobs end."""

    def __init__(
        self,
        attempts: int,
        folder: FleetFolder,
        jobs: tuple[Job, ...],
        results: dict[str, dict[str, Any]],
        progress: Progress,
        note: Callable[[str], None],
    ) -> None:
        self._attempts, self._folder, self._results = attempts, folder, results
        self._progress, self._note = progress, note
        self._jobs = {job.id: job for job in jobs}
        self.left = deque(job for job in jobs if job.id not in results)
        self._starts: Counter[str] = Counter()
        self._ends: Counter[str] = Counter()
        self._problem: Exception | None = None
        self._lock = threading.Lock()
        self._noticed = -float("inf")

    def hear(self, message: TaskMessage) -> None:
        """Write a message to the log of its job; another thread calls this."""
        job = self._jobs.get(message.label)
        if job is None:
            return
        text = message.text
        if message.begins:
            with self._lock:
                self._starts[job.id] += 1
                start, lost = self._starts[job.id], self._starts[job.id] - 1 > self._ends[job.id]
            text = f"attempt {start} begins" + (": the worker of the attempt before was lost" if lost else "")
        try:
            self._folder.log(job.id, f"{message.worker} {_here(text, job)}")
        except FleetFolderError as error:
            self._problem = self._problem or error

    def work(self, executor: Executor) -> bool:
        """Run the jobs that are left; return True if somebody asked to cancel."""
        waiting: dict[Future[Answer], Job] = {}
        self._progress(len(self._results), "")
        while self.left or waiting:
            if self._problem is not None:
                raise self._problem
            if self._folder.is_cancelled:
                return True
            slots = executor.slots()
            self._notice(slots)
            while self.left and len(waiting) < max(1, slots + min(slots, MOST_AHEAD)):
                job = self.left.popleft()
                if (future := self._submitted(executor, job)) is not None:
                    waiting[future] = job
            for future in wait(waiting, POLL_S, FIRST_COMPLETED).done:
                self._take(waiting.pop(future), future)
        return False

    def _notice(self, slots: int) -> None:
        now = time.monotonic()
        if slots == 0 and now - self._noticed > NOTICE_S:
            self._noticed = now
            self._note(
                "no worker is connected; the jobs wait. One of this machine starts again by itself, another one with "
                "`dask worker ADDRESS`; Ctrl-C stops"
            )

    def _submitted(self, executor: Executor, job: Job) -> Future[Answer] | None:
        try:
            content = job.content()
        except FleetError as error:
            self._finish(job, {"status": "failed", "error": str(error), "row": {}, "answer": ""}, {})
            return None
        roles = {one.place: one.role for one in job.inputs}
        names = {one.place: str(one.path) for one in job.inputs}
        return executor.submit(
            perform_job, GivenJob(job.kind, job.seed, dict(job.options), content, roles, names), job.id
        )

    def _take(self, job: Job, future: Future[Answer]) -> None:
        """Take the end of an attempt; raises ExecutorError and FleetFolderError."""
        with self._lock:
            self._ends[job.id] = max(self._starts[job.id], 1)
            attempt = self._ends[job.id]
        try:
            answer = future.result()
        except CancelledError:
            return
        except WorkerLostError as error:
            self._again(job, attempt, str(error), {})
            return
        about = {
            "worker": answer.worker,
            "host": answer.host,
            "seconds": round(answer.seconds, 3),
            "cpu_s": round(answer.cpu_s, 3),
        }
        if answer.failure is not None:
            self._folder.log(job.id, answer.failure.trace)
            self._again(job, attempt, answer.failure.sentence, about, is_final=answer.failure.is_final)
            return
        made: MadeJob = answer.value
        self._finish(
            job, {"status": "done", "row": made.row, "answer": made.answer, "attempts": attempt, **about}, made.files
        )

    def _again(self, job: Job, attempt: int, sentence: str, about: dict[str, Any], *, is_final: bool = False) -> None:
        """Hand a job out again after a failure, or give it up."""
        sentence = _here(sentence, job)
        if is_final or attempt >= self._attempts:
            failed = {"status": "failed", "error": sentence, "row": {}, "answer": "", "attempts": attempt, **about}
            self._finish(job, failed, {})
        else:
            self._folder.log(job.id, f"attempt {attempt} failed: {sentence}")
            self.left.append(job)

    def _finish(self, job: Job, end: dict[str, Any], files: dict[str, bytes]) -> None:
        document = {
            "id": job.id,
            "kind": job.kind,
            "rig": job.rig,
            "record": job.record,
            "seed": job.seed,
            "options": dict(job.options),
            "inputs": [{"role": one.role, "path": str(one.path), "sha256": one.sha256} for one in job.inputs],
            "hil": __version__,
            "ended": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            **end,
        }
        self._folder.log(job.id, end.get("error") or f"done: {end['answer']}")
        if not self._folder.write_result(job.id, document, files):
            with contextlib.suppress(FleetError):
                document = self._folder.result(job.id) or document
        self._results[job.id] = document
        self._progress(len(self._results), f"{job.id}: {document['status']}")


def _here(text: str, job: Job) -> str:
    """Return a worker's sentence with the paths of inputs as they are on this machine."""
    for one in job.inputs:
        path = str(one.path).replace("\\", "\\\\")  # a backslash would begin a group
        text = re.sub(rf"[^\s'\"]*hil-job-\w+/{re.escape(one.place)}", path, text)
    return text
