"""Paths with any legal character, for libraries and outputs that accept fewer characters than the file system.

A file name on Linux is any sequence of bytes without `/` and NUL. Python holds a byte that is no UTF-8 as a lone
surrogate (PEP 383). SQLite reads `?`, `#` and `%` of a URI as syntax (https://sqlite.org/uri.html). Arrow, Rerun and
every text file that the harness writes take UTF-8 alone.
"""

from __future__ import annotations

import codecs
import contextlib
import os
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path

LONGEST_NAME = 255
"""Bytes of one path component where the file system gives no limit (NAME_MAX of ext4, XFS, btrfs and tmpfs)."""
LONGEST_DATABASE_PATH = 504
"""Most bytes of a database's absolute path: SQLite's MAX_PATHNAME is 512, and its log has `-journal` appended."""
ENDINGS = 40
"""Bytes of a folder's name that stay free for endings: `-99`, `.run.json`, `.PID.part`."""


def connect_read_only(database: Path, timeout_s: float = 5.0) -> sqlite3.Connection:
    """Return a read-only connection to a SQLite file, with any characters in its path.

    Raises
    ------
    sqlite3.Error
        SQLite cannot open it.
    """
    return sqlite3.connect(f"{database.absolute().as_uri()}?mode=ro", uri=True, timeout=timeout_s)


@contextlib.contextmanager
def utf8_path(path: Path) -> Iterator[Path]:
    """Yield `path`, or for a folder that is no UTF-8 another path to the same file, valid within the block.

    The other path goes through the open folder, so that this process and its children can use it. The name of the file
    itself must be UTF-8.

    Raises
    ------
    OSError
        The folder of `path` cannot be opened.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        pass
    else:
        yield path
        return
    folder = os.open(path.absolute().parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield Path(f"/proc/{os.getpid()}/fd/{folder}") / path.name
    finally:
        os.close(folder)


def printable(text: str) -> str:
    """Return `text` with `?` in place of each lone surrogate, so that it can be written as UTF-8."""
    return text.encode("utf-8", "replace").decode()


def on_terminal(text: str) -> str:
    """Return `text` with control characters and lone surrogates as escapes: names in files may hold what a terminal
    obeys."""
    return "".join(c if c.isprintable() or c == "\t" else repr(c)[1:-1] for c in text)


def safe_file_name(text: str, longest: int = LONGEST_NAME) -> str:
    """Return a file name made of `text`: control characters, surrogates and `/` become `_`, cut to `longest` bytes."""
    plain = "".join(character if character.isprintable() and character != "/" else "_" for character in text)
    return plain.encode("utf-8")[: max(longest, 1)].decode("utf-8", "ignore")


def longest_name(folder: Path) -> int:
    """Return the most bytes of a name in `folder`."""
    try:
        return os.pathconf(folder, "PC_NAME_MAX")
    except (OSError, ValueError):
        return LONGEST_NAME


def accept_any_name() -> None:
    """Set standard output and error to accept every string: a file name's raw bytes unchanged, all else escaped.

    A printed path can then be pasted into a shell, and no name ends a run with UnicodeEncodeError.
    """
    codecs.register_error("any-name", _encoded)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None and hasattr(stream, "reconfigure"):
            with contextlib.suppress(OSError, ValueError):
                stream.reconfigure(errors="any-name")


def _encoded(error: UnicodeError) -> tuple[bytes | str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wrong = error.object[error.start : error.end]
    pieces = (
        bytes([ord(character) - 0xDC00])
        if 0xDC80 <= ord(character) <= 0xDCFF
        else character.encode("ascii", "backslashreplace")
        for character in wrong
    )
    return b"".join(pieces), error.end
