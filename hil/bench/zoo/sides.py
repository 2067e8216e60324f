"""Making side of a case as a task of an executor, in a process of its own: it returns the bytes of files, so that it
runs on any worker. The answering side is that of `hil.bench.discovery`.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from hil.bench.discovery import GIVEN, WorkerError, sealed_folder, side_process
from hil.executor import Say


def make(request: dict[str, Any], say: Say) -> dict[str, Any]:
    """Make a case and seal it; return its files, the text of its truth and its hash, or the error of the injector."""
    sealed = sealed_folder()
    with tempfile.TemporaryDirectory(prefix="hil-case-") as name:
        try:
            made = side_process("hil.bench.zoo.injector", str(sealed)).ask(**request, folder=name)
        except WorkerError as error:
            return {"error": str(error)}
        truth = sealed / f"{request['name']}.json"
        text = truth.read_bytes()
        truth.unlink()
        return {**made, **{role: Path(made[role]).read_bytes() for role in GIVEN}, "truth": text}
