"""Folders of runs that have ended: a made-up journal and the `run.json` that goes with it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from hil.journal.writer import JournalWriter
from hil.run_folder.folder import RunFolder, new_manifest
from tests.hil.synthetic_journal import make, narrowed, put_ticks


def ended_run(
    path: Path, *, ticks: int = 300, ended: bool = True, narrow: bool = False
) -> tuple[RunFolder, dict[str, Any]]:
    """A run of `ticks` in a new folder `path`, with two twins; with `ended` its journal says that it is done.

    With `narrow` it has few signals and one twin, for what does not depend on them: files are made faster.
    """
    path.mkdir(parents=True)
    folder, truth = RunFolder(path), make(ticks)
    if narrow:
        truth = narrowed(truth)
    writer = JournalWriter(folder.journal, truth.header)
    writer.state(0, 0.0, 0.0, "restoring", "start", "running", "the test")
    put_ticks(writer, truth, 0, ticks)
    writer.event(10, 10.0, "WARN", "a warning of the test")
    if ended:
        writer.state(ticks - 1, ticks - 1.0, ticks - 1.0, "running", "complete", "done", "the profile is over")
        writer.put_meta("exit_status", "done")
    writer.close()
    manifest = new_manifest({}, network_mode="shadow")
    if ended:
        manifest |= {"exit_status": "done", "reason": "the profile is over", "safe": True, "ticks": ticks}
    return folder, manifest


def wait_until(condition: Any, within_s: float = 60.0) -> None:
    """Poll until `condition()` is true."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
