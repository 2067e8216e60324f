"""Training and benchmarks on a worker, as commands of `hil` in a process of their own.

That process ends with its worker, also if the worker is killed: it watches its standard input, which then ends.
"""

from __future__ import annotations

import os
import queue
import runpy
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path
from typing import IO, Any

from hil.errors import FOUND, USAGE
from hil.executor import Say
from hil.files import parse_json
from hil.fleet.fleet_file import FleetError
from hil.fleet.kinds.job_folder import JobFolder, MadeJob

PROJECT = Path(__file__).resolve().parents[3]
LAST_LINES = 5
"""Lines of the standard error that a failure repeats."""
ALIVE_S = 30.0
"""Silence of a command, s, after which its job reports that it runs: a cancelled job ends at its next message."""
ORPHANED = 3
"""Exit code of a command whose worker is gone."""


class SubcommandError(RuntimeError):
    """Error of a command that failed; the message has its last lines."""


def trained(folder: JobFolder, say: Say) -> MadeJob:
    """Train a member of the network; raises SubcommandError, or FleetError for wrong arguments."""
    data = folder.path / "data"
    words = ["train", "loop", "--seed", str(folder.given.seed), "--out", "out", "--data", str(data)]
    document = _run(folder, [*words, "--json", *folder.given.options["arguments"]], say)
    row = {"steps": document["steps"], "training_s": document["seconds"]}
    return MadeJob(row, "; ".join(document["lines"]), folder.results())


def benched(folder: JobFolder, say: Say) -> MadeJob:
    """Run a benchmark; raises SubcommandError, or FleetError for wrong arguments."""
    options = folder.given.options
    words = ["bench", options["bench"], "--seed", str(folder.given.seed), "--out", "out", "--json"]
    document = _run(folder, [*words, *options["arguments"]], say)
    count = sum(len(table["rows"]) for table in document["tables"].values())
    return MadeJob({"rows": count}, f"{options['bench']}: {count} rows", folder.results())


def _run(folder: JobFolder, words: list[str], say: Say) -> dict[str, Any]:
    """Run a command of hil in the job's folder; return the JSON that it prints, and keep it as a result.

    A benchmark that finds a fault of what it measures ends with exit code 1 and has its report.
    """
    path = os.pathsep.join((str(PROJECT), *filter(None, (os.environ.get("PYTHONPATH"),))))
    environment = {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    folder.out.mkdir()
    say(f"hil {' '.join(words)}")
    last: deque[str] = deque(maxlen=LAST_LINES)
    printed = folder.path / "printed.json"
    with printed.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import main; main()", *words],
            cwd=folder.path,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )
    assert process.stdin is not None and process.stderr is not None
    lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
    reader = threading.Thread(target=_hand_over, args=(process.stderr, lines), name="lines", daemon=True)
    reader.start()
    began = time.monotonic()
    try:
        while (line := _next(lines)) is not None:
            if text := line.rstrip():
                last.append(text)
            say(text or f"runs for {time.monotonic() - began:.0f} s")
        code = process.wait()
    finally:
        process.kill()
        process.wait()
        reader.join()
        process.stdin.close()
        process.stderr.close()
    said = [text.removeprefix("hil: ").removeprefix("Error: ") for text in last]
    if code == USAGE:
        raise FleetError(f"hil {' '.join(words[:2])}: {said[-1] if said else 'it refuses its options'}")
    content = printed.read_bytes()
    printed.unlink()
    if code not in (0, FOUND) or not content.strip():
        raise SubcommandError(f"hil {' '.join(words[:2])} ended with exit code {code}: {' / '.join(said)}")
    found: dict[str, Any] = parse_json(content)
    (folder.out / f"{words[0]}.json").write_bytes(content)
    return found


def _hand_over(lines: IO[str], to: queue.SimpleQueue[str | None]) -> None:
    """Put lines that are not empty into a queue, and None at their end."""
    for line in lines:
        if line.strip():
            to.put(line)
    to.put(None)


def _next(lines: queue.SimpleQueue[str | None]) -> str | None:
    """Return the next line, an empty one after `ALIVE_S` without any, and None at the end."""
    try:
        return lines.get(timeout=ALIVE_S)
    except queue.Empty:
        return ""


def _end_with_parent() -> None:
    while os.read(0, 4096):  # not sys.stdin: its lock would be held when the interpreter ends
        pass
    os._exit(ORPHANED)


def main() -> None:
    """Run the command of hil in the arguments, until the standard input ends."""
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    sys.argv[0] = "hil"
    runpy.run_module("hil", run_name="__main__")
