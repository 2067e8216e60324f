"""Worker process that answers one request in each line: JSON in on stdin, JSON out on stdout.

Both sides of `hil bench discovery` are such processes, so that neither shares memory with the other: what the one that
diagnoses gets to know is what stands in its requests.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

PROJECT = Path(__file__).resolve().parents[3]
Request = dict[str, Any]


class WorkerError(RuntimeError):
    """Error of a worker that ended or failed; the message is its own."""


class Worker:
    """Client of a module run as `python -m`; starts it at the first request and again after its end.

    Requests of several threads are answered one after the other.
    """

    def __init__(self, module: str, *arguments: str) -> None:
        self._command = [sys.executable, "-m", module, *arguments]
        self._process: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def ask(self, **request: Any) -> Request:
        """Return the answer to one request; raise WorkerError."""
        with self._lock:
            return self._ask(request)

    def _ask(self, request: Request) -> Request:
        if self._process is None or self._process.poll() is not None:
            self.close()
            one_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
            environment = {**os.environ, "PYTHONPATH": str(PROJECT), **one_thread}
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
            )
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise WorkerError(f"{self._command[2]} ended with exit code {self._process.wait()}")
        answer: Request = json.loads(line)
        if "error" in answer:
            raise WorkerError(answer["error"])
        return answer

    def close(self) -> None:
        """End the process and wait for it."""
        process, self._process = self._process, None
        if process is not None:
            assert process.stdin is not None and process.stdout is not None
            process.stdin.close()
            process.wait()
            process.stdout.close()


def serve(answer: Callable[[Request], Request]) -> None:
    """Answer requests until stdin ends; an exception becomes an answer with its text."""
    # Output of a library must not appear among the answers.
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        try:
            said = answer(json.loads(line))
        except Exception as error:
            said = {"error": f"{type(error).__name__}: {error}"}
        out.write(json.dumps(said) + "\n")
        out.flush()
    out.close()
