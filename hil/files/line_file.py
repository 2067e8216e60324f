"""Files of lines that are only ever appended, by any number of processes, and that a crash may cut at their end."""

from __future__ import annotations

import os
from pathlib import Path

_CUT = b" #cut"
"""End of a line that a crash cut, added with the next line: JSON never ends so."""


def append_line(path: Path, line: str) -> None:
    """Append a line and have it on the disk before this returns; raises OSError, also for a link.

    A last line that a crash has cut is marked, and `read_lines` leaves it out.
    """
    handle = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
    with open(handle, "r+b", buffering=0) as file:
        size = file.seek(0, os.SEEK_END)
        torn = size > 0 and os.pread(handle, 1, size - 1) != b"\n"
        # In one call, so that two writers do not mix.
        file.write((_CUT + b"\n") * torn + line.encode("utf-8") + b"\n")
        os.fsync(handle)


def read_lines(path: Path, most_bytes: int) -> list[tuple[int, bytes]]:
    """Return the complete lines of a file with their numbers from 1, without empty ones and those that a crash cut.

    Parameters
    ----------
    path
        File; one that is not there has no lines.
    most_bytes
        Bytes that are read at most.

    Raises
    ------
    OSError
        The file cannot be read, or is a link.
    """
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
            content = file.read(most_bytes)
    except FileNotFoundError:
        return []
    lines = enumerate(content.split(b"\n")[:-1], 1)
    return [(number, line) for number, line in lines if line.strip() and not line.endswith(_CUT)]
