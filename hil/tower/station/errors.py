"""Errors of the tower's commands that a user can mend."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class TowerOutputError(Exception):
    """A result cannot be written; one sentence that names the folder and the remedy."""


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Raise TowerOutputError where a file in or at `out` cannot be written, as on a full disk."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise TowerOutputError(f"{out}: cannot be written: {reason}; make room, or give another path") from error
