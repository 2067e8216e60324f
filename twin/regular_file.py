"""Reading of whole files that people name: regular files only, up to a limit.

A pipe, a socket, a terminal or a device in the place of a file would hold a reader for ever, or never end.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST_TEXT = 8 * 10**6
"""Bytes of a configuration: a twin of a hundred elements has some ten thousand, and TOML is read at some MB a
second."""
MOST_WEIGHTS = 2 * 10**9
"""Bytes of the weights of a network: the largest that is trained here has some hundred million numbers."""
_KINDS = (
    (stat.S_ISDIR, errno.EISDIR, "it is a folder"),
    (stat.S_ISFIFO, errno.EINVAL, "it is a pipe, no regular file"),
    (stat.S_ISSOCK, errno.EINVAL, "it is a socket, no regular file"),
    (stat.S_ISCHR, errno.EINVAL, "it is a device, no regular file"),
    (stat.S_ISBLK, errno.EINVAL, "it is a device, no regular file"),
)


def read_regular(path: Path, most: int = MOST_TEXT) -> bytes:
    """Return the bytes of a regular file.

    Raises
    ------
    OSError
        It cannot be read, is no regular file, or has more than `most` bytes; `strerror` says which.
    """
    refuse_irregular(path, os.stat(path).st_mode)
    # Without O_NONBLOCK a pipe that took the file's place meanwhile would hold this call for ever.
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY), "rb") as file:
        status = os.fstat(file.fileno())
        refuse_irregular(path, status.st_mode)
        content = b"" if status.st_size > most else file.read(most + 1)
    size = max(status.st_size, len(content))
    if size > most:
        raise OSError(errno.EFBIG, f"it has {size / 1e6:.0f} MB, and at most {most / 1e6:.0f} MB are read", str(path))
    return content


def refuse_irregular(path: Path, mode: int) -> None:
    """Raise OSError where the `mode` of a file is not that of a regular one; `strerror` names its kind."""
    for is_kind, number, what in _KINDS:
        if is_kind(mode):
            raise OSError(number, what, str(path))


__all__ = ["MOST_TEXT", "MOST_WEIGHTS", "read_regular", "refuse_irregular"]
