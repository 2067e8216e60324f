"""Checks of a run folder before its files are used: it may come from anybody.

A run folder must hold plain files and folders of its own. A link could direct a writer outside, a pipe or a device
could block a reader for ever. JSON is read up to a limit of size and depth.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Any

from hil.files.json_text import parse_json
from hil.files.limits import MOST_JSON, Failure

CONTROL = "control.sock"
"""The only socket that a run folder may hold."""


def require_plain(folder: Path, failure: Failure) -> None:
    """Check that a folder holds nothing but files and folders, and at its top the control socket of a live run.

    Raises
    ------
    failure
        It holds a link, a pipe or a device, in one sentence.
    """
    for path, status in _entries(folder):
        if stat.S_ISLNK(status.st_mode):
            raise failure(
                f"{path} is a link to {os.readlink(path)!r}, and a run folder holds files only: nothing in it is "
                "used; put the file itself there, or take the link away"
            )
        fine = stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)
        if not fine and not (stat.S_ISSOCK(status.st_mode) and path == folder / CONTROL):
            raise failure(f"{path} is no plain file, and a run folder holds files only; take it away")


def require_unshared(folder: Path, failure: Failure) -> None:
    """Check that no file of a folder has a second hard link: a write would change the file under both names.

    Raises
    ------
    failure
        A file has one, in one sentence.
    """
    for path, status in _entries(folder):
        if stat.S_ISREG(status.st_mode) and status.st_nlink > 1:
            raise failure(
                f"{path} has {status.st_nlink} names (hard links), and the run would write on under all of them; "
                f"replace it by a copy: cp {path.name} copy && mv copy {path.name}"
            )


def read_json(path: Path, failure: Failure) -> Any:
    """Return the document of a JSON file, read without following a link.

    Raises
    ------
    failure
        The file is too large, too deep, or no JSON. FileNotFoundError: there is no file. OSError: it cannot be
        read.
    """
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise failure(f"{path} is no plain file; take it away")
        if status.st_size > MOST_JSON:
            raise failure(f"{path} has {status.st_size / 1e6:.0f} MB, and at most {MOST_JSON / 1e6:.0f} MB are read")
        content = file.read()
    try:
        return parse_json(content)
    except ValueError as error:
        raise failure(f"{path} is damaged ({error})") from None


def _entries(folder: Path) -> list[tuple[Path, os.stat_result]]:
    """Return all paths in a folder and below, without following links or files that a live run removes meanwhile."""
    found, left = [], [folder]
    while left:
        try:
            paths = sorted(left.pop().iterdir())
        except OSError:
            continue
        for path in paths:
            try:
                status = path.lstat()
            except OSError:
                continue
            found.append((path, status))
            if stat.S_ISDIR(status.st_mode):
                left.append(path)
    return found


__all__ = ["read_json", "require_plain", "require_unshared"]
