"""Atomic writing of files."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from hil.files.limits import Failure
from hil.files.names import LONGEST_NAME


def require_writable(folder: Path, failure: Failure, remedy: str = "make it writable, or choose another place") -> None:
    """Check that files can be made in a folder, or in the nearest folder above where it does not exist yet.

    A file without a name is made: permissions alone do not show a file system that is read-only.

    Raises
    ------
    failure
        No file can be made there, in one sentence with the `remedy`.
    """
    nearest = next((one for one in (folder, *folder.absolute().parents) if one.exists()), folder)
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise failure(f"{folder}: no file can be written there ({error.strerror or error}); {remedy}") from None


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path, which replaces `path` at the end of the block and is removed after an error.

    Raises
    ------
    OSError
        The file cannot be written or moved, or `path` is a device, pipe or socket.
    """
    with contextlib.suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode) or stat.S_ISDIR(mode)):
            raise OSError(errno.EINVAL, "it is a device, pipe or socket, which a file would take the place of")
    ending = f".{os.getpid()}.part"
    # A name as long as the file system allows has no room for the ending.
    kept = os.fsencode(path.name)[: LONGEST_NAME - len(ending) - 1]
    unfinished = path.with_name(f".{os.fsdecode(kept)}{ending}")
    try:
        yield unfinished
        with unfinished.open("rb") as handle:
            os.fsync(handle.fileno())
        unfinished.replace(path)
    except OSError as error:
        if error.filename is not None and os.fspath(error.filename) == os.fspath(unfinished):
            error.filename = os.fspath(path)  # users know nothing of the other
        raise
    finally:
        with contextlib.suppress(PermissionError, NotADirectoryError):
            unfinished.unlink(missing_ok=True)
