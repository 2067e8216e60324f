"""Folders that one process at a time writes, and whose files are replaced together.

A result of several files is written into a folder of its own inside the target, which one rename then declares ready.
A process that is killed before leaves the old files as they were. One that is killed after leaves the folder `.ready`,
from which the next process completes the replacement.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from hil.files.limits import Failure

READY = ".ready"
ASKING_S = 0.5
"""Time for which a lock on a folder is tried, s: a reader that asks holds it between two system calls."""


def take_lock(handle: int) -> None:
    """Lock an open folder for this process, past the moments in which others ask; raises OSError.

    The kernel releases the lock when the folder is closed, at the latest with the process.
    """
    deadline = time.monotonic() + ASKING_S
    while True:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError:
            if time.monotonic() >= deadline:
                raise
        time.sleep(ASKING_S / 50)


@contextlib.contextmanager
def held(folder: Path, failure: Failure) -> Iterator[None]:
    """Make a folder and hold it for this process; folders that were made and stay empty are removed.

    A file system without locks is accepted.

    Raises
    ------
    failure
        Another process holds the folder, in one sentence.
    OSError
        The folder cannot be made.
    """
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    handle = _open_locked(folder, failure)
    try:
        yield
    finally:
        for one in made:
            with contextlib.suppress(OSError):
                one.rmdir()
        os.close(handle)


def _open_locked(folder: Path, failure: Failure) -> int:
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            take_lock(handle)
        except BlockingIOError:
            os.close(handle)
            raise failure(
                f"{folder}: another process works on this folder; wait until it has ended, or give another folder"
            ) from None
        except OSError:
            pass
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(folder.stat(), os.fstat(handle)):
                return handle
        os.close(handle)  # removed meanwhile, by a process that left it empty


@contextlib.contextmanager
def replacing_all(folder: Path, is_own: Callable[[str], bool]) -> Iterator[Path]:
    """Yield an empty folder whose files replace the result in `folder` when the block ends well.

    Parameters
    ----------
    folder
        Folder of the result, which the caller holds (`held`).
    is_own
        Function that tells the names of the result's files. Those that are not written anew are removed.

    Raises
    ------
    OSError
        A file cannot be written or moved.
    """
    complete(folder, is_own)
    for left in folder.glob(".*.part"):  # of processes that were killed
        if left.is_dir() and not left.is_symlink():
            shutil.rmtree(left, ignore_errors=True)
    part = folder / f".{os.getpid()}.part"
    part.mkdir()
    try:
        yield part
        for path in part.iterdir():
            with path.open("rb") as handle:
                os.fsync(handle.fileno())
        part.rename(folder / READY)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    complete(folder, is_own)


def complete(folder: Path, is_own: Callable[[str], bool]) -> None:
    """Complete a replacement that was cut after it was ready.

    Raises
    ------
    OSError
        A file cannot be moved.
    """
    ready = folder / READY
    if ready.is_symlink() or not ready.is_dir():
        return
    # What was moved before a cut is not among the new names any more: nothing is removed once a file was moved.
    new = {path.name for path in ready.iterdir()}
    begun = ready / ".begun"
    if begun.name not in new:
        for path in folder.iterdir():
            if is_own(path.name) and path.name not in new:
                path.unlink()
        begun.touch()
    for path in sorted(ready.iterdir()):
        if path != begun:
            path.replace(folder / path.name)
    begun.unlink()
    ready.rmdir()


def require_complete(folder: Path, failure: Failure) -> None:
    """Check that no replacement of a folder's files was cut, so that they belong together.

    Raises
    ------
    failure
        One was cut, in one sentence.
    """
    if (folder / READY).is_dir():
        raise failure(
            f"{folder}: the command that wrote this folder was cut while it replaced the files; run that command again"
        )


__all__ = ["complete", "held", "replacing_all", "require_complete", "take_lock"]
