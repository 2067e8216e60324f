"""Executor on Dask distributed: a cluster of its own, or a scheduler elsewhere. Only this module imports Dask.

The data of a task are part of the task, which the scheduler keeps until it has an answer. Data that are placed on a
worker beforehand would be lost with that worker.
"""

from __future__ import annotations

import contextlib
import logging
import uuid
import warnings
from concurrent.futures import Future, InvalidStateError
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dask
from distributed import Client, LocalCluster, get_worker
from distributed import Future as DaskFuture
from distributed.scheduler import KilledWorker
from distributed.security import Security
from distributed.versions import VersionMismatchWarning

from hil.executor.code_identity import CodeIdentity, code_identity
from hil.executor.contract import Answer, ExecutorError, Hear, Say, Task, TaskMessage, WorkerLostError
from hil.executor.task import OtherVersionError, perform, sentence_of

CONNECT_S = 10.0
"""Time for which a scheduler is called, s."""
LOOPBACK = "127.0.0.1"
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
SETTINGS = {
    # A whole record is part of a task by intention.
    "distributed.admin.large-graph-warning-threshold": "100 GB",
    # No page of a dashboard, and no other page of the scheduler and the workers.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    # Variables of a worker before numpy is loaded there.
    "distributed.nanny.pre-spawn-environ": {"MALLOC_TRIM_THRESHOLD_": 65536, **ONE_THREAD},
    "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
}


@dataclass(frozen=True, slots=True)
class TlsFiles:
    """Files for TLS: certificate of the authority, own certificate and key (PEM)."""

    ca: Path
    cert: Path
    key: Path


class _Cancelled(BaseException):
    """End of a task that the client gave up; nothing of a task catches it."""


def on_worker(task: Task, given: Any, label: str, topic: str, wanted: CodeIdentity) -> Answer:
    """Run a task on this worker of Dask; its messages go to the clients that listen to the topic."""
    worker = get_worker()
    key = worker.get_current_task()

    def say(text: str, begins: bool = False) -> None:
        known = worker.state.tasks.get(key)
        if known is None or known.state == "cancelled":
            raise _Cancelled
        worker.log_event(topic, {"label": label, "worker": worker.address, "text": text, "begins": begins})

    say("begins", begins=True)
    return perform(task, given, say, worker.address, wanted)


class DaskExecutor:
    """Executor on the workers of a Dask scheduler.

    Parameters
    ----------
    hear
        Callback for the messages of tasks.
    address
        Address of a scheduler, such as `tcp://host:8786`; None starts a cluster of this process.
    workers
        Worker processes of the own cluster, one thread each.
    tls
        Certificates for an address `tls://`.

    Raises
    ------
    ExecutorError
        The scheduler cannot be reached, or a worker has other code.
    """

    def __init__(self, hear: Hear, address: str | None = None, workers: int = 1, tls: TlsFiles | None = None) -> None:
        self._hear, self._topic, self._closed = hear, f"hil-{uuid.uuid4().hex}", False
        self._cluster: LocalCluster | None = None
        self._waiting: dict[str, tuple[DaskFuture[Any], Future[Answer]]] = {}
        self._name = address or "the cluster of this command"
        # Sentences of our own take the place of the warnings and logs of Dask.
        warnings.filterwarnings("ignore", category=VersionMismatchWarning)
        for name in logging.root.manager.loggerDict:  # Dask has set a level for each of them
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)
        dask.config.set(SETTINGS)
        if address is None:
            self._cluster = _own_cluster(workers)
            self._client = Client(self._cluster, set_as_default=False)
        else:
            self._client = _connected(address, tls)
        try:
            self._require_same_code()
        except BaseException:
            self.close()
            raise
        self._client.subscribe_topic(self._topic, self._heard)

    def _require_same_code(self) -> None:
        """Compare the code of the workers that are there; a later one is compared by its first task."""
        ours = code_identity()
        versions: Any = self._client.get_versions()
        for worker, told in versions["workers"].items():
            python = ".".join(str(told["host"]["python"]).split(".")[:2])
            if python != ours.python:
                raise ExecutorError(sentence_of(worker, f"Python {python}, here it is {ours.python}"))
        found: dict[str, Any] = self._client.run(code_identity, on_error="return")
        for worker, theirs in found.items():
            if not isinstance(theirs, CodeIdentity):
                raise ExecutorError(sentence_of(worker, f"no hil, or an older one ({theirs})"))
            if difference := ours.difference(theirs):
                raise ExecutorError(sentence_of(worker, difference))

    def slots(self) -> int:
        """Return the number of threads of the workers that are connected."""
        try:
            return sum(self._client.nthreads().values())
        except (OSError, TimeoutError, ValueError):
            return 0

    def submit(self, task: Task, given: Any, label: str) -> Future[Answer]:
        """Hand a task to a worker, with its data."""
        ours: Future[Answer] = Future()
        theirs = self._client.submit(
            on_worker,
            task,
            given,
            label,
            self._topic,
            code_identity(),
            key=f"{label}-{uuid.uuid4().hex}",
            pure=False,
        )
        self._waiting[str(theirs.key)] = (theirs, ours)
        theirs.add_done_callback(self._done)
        return ours

    def _done(self, theirs: DaskFuture[Any]) -> None:
        """Take an answer over at once, so that the loss of its worker loses nothing."""
        entry = self._waiting.pop(str(theirs.key), None)
        if entry is None:
            return
        ours = entry[1]
        with contextlib.suppress(InvalidStateError):  # cancelled by this process
            try:
                answer = theirs.result()
            except KilledWorker as error:
                ours.set_exception(WorkerLostError(f"its worker {error.last_worker.address} ended while it ran"))
            except OtherVersionError as error:
                ours.set_exception(ExecutorError(str(error)))
            except BaseException:  # cancelled, or no connection: a task's own error is in its answer
                ours.set_exception(
                    ExecutorError(f"{self._name} was lost; start it again, and then give the same command")
                )
            else:
                ours.set_result(answer)
            theirs.release()

    def _heard(self, event: tuple[float, dict[str, Any]]) -> None:
        self._hear(TaskMessage(**event[1]))

    def close(self) -> None:
        """Cancel what is in progress, and end the own cluster.

        Workers elsewhere end a cancelled task at its next message.
        """
        if self._closed:
            return
        self._closed = True
        waiting = list(self._waiting.values())
        left = [theirs for theirs, _ in waiting]
        self._waiting.clear()
        with contextlib.suppress(Exception):  # the scheduler may be gone
            if left:
                self._client.cancel(left, force=True)
        with contextlib.suppress(Exception):
            self._client.close()
        if self._cluster is not None:
            self._cluster.close()
        for _, ours in waiting:
            with contextlib.suppress(InvalidStateError):
                ours.set_exception(ExecutorError(f"{self._name} was closed before the task was done"))


def _own_cluster(workers: int) -> LocalCluster:
    """Start a cluster on the loopback interface; others on this machine lack its certificate, which no file holds."""
    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host=LOOPBACK,
        protocol="tls://",
        security=Security.temporary(),
        dashboard_address=f"{LOOPBACK}:0",
        worker_dashboard_address=None,
        # A diagnosis may take more than a worker's share of the memory for a while.
        memory_limit=0,
        silence_logs=logging.CRITICAL,
    )


def _connected(address: str, tls: TlsFiles | None) -> Client:
    security = None
    if tls is not None:
        security = Security(
            tls_ca_file=str(tls.ca),
            tls_client_cert=str(tls.cert),
            tls_client_key=str(tls.key),
            require_encryption=True,
        )
    try:
        return Client(address, timeout=CONNECT_S, security=security, set_as_default=False)
    except (OSError, TimeoutError, ValueError, TypeError, RuntimeError) as error:
        raise ExecutorError(
            f"no Dask scheduler answers at {address} ({_first_line(error)}); start one with `dask scheduler`, or "
            "correct the address"
        ) from None


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0][:160]


__all__ = ["DaskExecutor", "Say", "TlsFiles"]
