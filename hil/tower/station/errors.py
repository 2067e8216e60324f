"""Errors of the tower's commands that a user can mend."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.historian import why_unwritten


class TowerOutputError(Exception):
    """A result cannot be written; one sentence that names the folder and the remedy."""


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Raise TowerOutputError where a file in or at `out` cannot be written, with the remedy."""
    try:
        yield
    except OSError as error:
        raise TowerOutputError(f"{out}: cannot be written: {why_unwritten(error)}") from error
