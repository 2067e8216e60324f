"""Check of the file that a command is asked to write: it must not be one that a run wrote."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Iterable
from pathlib import Path

from hil.files import Failure, require_writable

_OWN = (
    "journal.sqlite*",
    "record.parquet",
    "review.rrd",
    "twin*.toml",
    "*.healthy.parquet",
    "report.html",
    "report.pdf",
    "run.json",
    "alarms.jsonl",
    "alarms-notified.json",
    "notes.jsonl",
    "verdict.json",
    "junit.xml",
    "control.sock",
    "stream-*",
    "guardian.log",
)
"""Names of files that a run and the commands on it write into its folder."""
_RESULTS = ("diagnosis", "explanation")
"""Folders of results in that of a run."""


def require_output(path: Path, failure: Failure, sources: Iterable[Path] = ()) -> None:
    """Check that a command may write `path`: the file that it was asked for, and nobody's else.

    Parameters
    ----------
    path
        File to write.
    failure
        Exception to raise.
    sources
        Files that the command reads.

    Raises
    ------
    failure
        It is a folder or a device, it has no folder or one that cannot be written, or it is a file of a run or a
        source; one sentence.
    """
    if path.is_dir():
        raise failure(f"{path} is a folder; name a file")
    if path.name == "-":
        raise failure(f"{path} would be a file of that name, and no standard output; name a file")
    is_stream = path.is_symlink() and os.fspath(path.readlink()).startswith("/proc/")  # /dev/stdout
    if is_stream or (path.exists() and not path.is_file()):
        raise failure(f"{path} is a device, pipe or socket, which a file would take the place of; name a file")
    if not path.parent.is_dir():
        raise failure(f"{path.parent} is no folder that is there; make it, or choose another place")
    require_writable(path.parent, failure)
    if path.exists() and any(source.exists() and path.samefile(source) for source in sources):
        raise failure(f"{path} is a file that this command reads; choose another name")
    place = path.resolve()  # a link leads to the file that would be lost
    for target in {place, path.parent.resolve() / path.name}:
        run = _run_of(target)
        if run is not None:
            raise failure(f"{path} is a file of the run {run}; choose another name")


def _run_of(path: Path) -> Path | None:
    """Return the folder of the run whose own file has this path; None for any other path."""
    folder = path.parent
    if folder.name in _RESULTS and (folder.parent / "run.json").exists():
        return folder.parent
    is_own = any(fnmatch.fnmatchcase(path.name, pattern) for pattern in _OWN)
    return folder if is_own and (folder / "run.json").exists() else None
