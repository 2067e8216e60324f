"""Training and benchmarks on a worker, as commands of `hil` in a process of their own.

That process ends with its worker, also if the worker is killed: it watches its standard input, which then ends.
"""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
import threading
from collections import deque
from pathlib import Path
from typing import Any

from hil.executor import Say
from hil.fleet.kinds.job_folder import JobFolder, MadeJob

PROJECT = Path(__file__).resolve().parents[3]
LAST_LINES = 5
"""Lines of the standard error that a failure repeats."""
ORPHANED = 3
"""Exit code of a command whose worker is gone."""


class SubcommandError(RuntimeError):
    """Error of a command that failed; the message has its last lines."""


def trained(folder: JobFolder, say: Say) -> MadeJob:
    """Train a member of the network; raises SubcommandError."""
    data = folder.path / "data"
    words = ["train", "loop", "--seed", str(folder.given.seed), "--out", "out", "--data", str(data)]
    document = _run(folder, [*words, "--json", *folder.given.options["arguments"]], say)
    row = {key: document[key] for key in ("done", "steps", "seconds")}
    return MadeJob(row, "; ".join(document["lines"]), folder.results())


def benched(folder: JobFolder, say: Say) -> MadeJob:
    """Run a benchmark; raises SubcommandError."""
    options = folder.given.options
    words = ["bench", options["bench"], "--seed", str(folder.given.seed), "--out", "out", "--json"]
    document = _run(folder, [*words, *options["arguments"]], say)
    count = sum(len(table["rows"]) for table in document.get("tables", ()))
    return MadeJob({"rows": count}, f"{options['bench']}: {count} rows", folder.results())


def _run(folder: JobFolder, words: list[str], say: Say) -> dict[str, Any]:
    """Run a command of hil in the job's folder; return the JSON that it prints."""
    path = os.pathsep.join((str(PROJECT), *filter(None, (os.environ.get("PYTHONPATH"),))))
    environment = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    folder.out.mkdir()
    say(f"hil {' '.join(words)}")
    last: deque[str] = deque(maxlen=LAST_LINES)
    printed = folder.out / "printed.json"
    with printed.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "hil.fleet.kinds.subcommand", *words],
            cwd=folder.path,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )
    assert process.stdin is not None and process.stderr is not None
    try:
        for line in process.stderr:
            if text := line.rstrip():
                last.append(text)
                say(text)
        code = process.wait()
    finally:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stderr.close()
    if code != 0:
        raise SubcommandError(f"hil {' '.join(words[:2])} ended with exit code {code}: {' / '.join(last)}")
    found: dict[str, Any] = json.loads(printed.read_text(encoding="utf-8"))
    return found


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(ORPHANED)


if __name__ == "__main__":
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    sys.argv[0] = "hil"
    runpy.run_module("hil", run_name="__main__")
