"""Atomic writing of files."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from hil.files.names import LONGEST_NAME


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path, which replaces `path` at the end of the block and is removed after an error.

    Raises
    ------
    OSError
        The file cannot be written or moved.
    """
    ending = f".{os.getpid()}.part"
    # A name as long as the file system allows has no room for the ending.
    kept = os.fsencode(path.name)[: LONGEST_NAME - len(ending) - 1]
    unfinished = path.with_name(f".{os.fsdecode(kept)}{ending}")
    try:
        yield unfinished
        with unfinished.open("rb") as handle:
            os.fsync(handle.fileno())
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
