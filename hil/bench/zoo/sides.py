"""Both sides of a case as tasks of an executor: one makes the case, the other answers it, each in its own process.

A task gets and returns the bytes of files, so that it runs on any worker. The answering side gets record, healthy
record and twin, and nothing else.
"""

from __future__ import annotations

import atexit
import functools
import tempfile
from pathlib import Path
from typing import Any

from hil.bench.discovery import Worker, WorkerError
from hil.executor import Say

GIVEN = {"record": "record.parquet", "healthy": "healthy.parquet", "twin": "twin.toml"}
"""Files that the answering side gets, by their role."""


@functools.cache
def _side(module: str, *arguments: str) -> Worker:
    """Return the process of a side, which lasts as long as this one."""
    worker = Worker(module, *arguments)
    atexit.register(worker.close)
    return worker


@functools.cache
def _sealed_folder() -> Path:
    made = tempfile.TemporaryDirectory(prefix="hil-sealed-")
    atexit.register(made.cleanup)
    return Path(made.name)


def make(request: dict[str, Any], say: Say) -> dict[str, Any]:
    """Make a case and seal it; return its files, the text of its truth and its hash, or the error of the injector."""
    sealed = _sealed_folder()
    with tempfile.TemporaryDirectory(prefix="hil-case-") as name:
        try:
            made = _side("hil.bench.zoo.injector", str(sealed)).ask(**request, folder=name)
        except WorkerError as error:
            return {"error": str(error)}
        truth = sealed / f"{request['name']}.json"
        text = truth.read_bytes()
        truth.unlink()
        return {**made, **{role: Path(made[role]).read_bytes() for role in GIVEN}, "truth": text}


def answer(given: dict[str, Any], say: Say) -> dict[str, Any]:
    """Diagnose a case; return the bytes of the answer and its processor time, or the error of the answerer."""
    with tempfile.TemporaryDirectory(prefix="hil-case-") as name:
        folder = Path(name)
        for role, file in GIVEN.items():
            (folder / file).write_bytes(given[role])
        paths = {role: str(folder / file) for role, file in GIVEN.items()}
        try:
            found = _side("hil.bench.discovery.answerer").ask(**paths, hour=given["hour"], out=name)
        except WorkerError as error:
            return {"error": str(error)}
        return {"answer": Path(found["answer"]).read_bytes(), "cpu_s": float(found["cpu_s"])}
