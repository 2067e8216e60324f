"""Errors of the tower's commands that a user can mend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from drivers.historian import why_unwritten
from hil.record import RecordError


class TowerOutputError(Exception):
    """A result cannot be written; one sentence that names the folder and the remedy."""


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Raise TowerOutputError where a file in or at `out` cannot be written, with the remedy."""
    try:
        yield
    except OSError as error:
        raise TowerOutputError(f"{out}: cannot be written: {why_unwritten(error)}") from error


class TableError(RecordError):
    """All mistakes of a file that a person wrote; its text is the first, and how many more there are.

    Attributes
    ----------
    problems
        A sentence a mistake, with file, line and remedy.
    """

    def __init__(self, path: Path, problems: Sequence[str]) -> None:
        more = len(problems) - 1
        super().__init__(f"{problems[0]} ({more} more: `hil check {path}` lists them)" if more else problems[0])
        self.problems = tuple(problems)


class Mistakes:
    """Collector of the mistakes of a file, so that each line is checked whatever is wrong with the others."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: dict[str, None] = {}

    @contextmanager
    def noted(self) -> Iterator[None]:
        """Note the RecordError that ends the block, and go on after it."""
        try:
            yield
        except TableError as error:
            self._found |= dict.fromkeys(error.problems)
        except RecordError as error:
            self._found[str(error)] = None

    def __bool__(self) -> bool:
        """Return True if a mistake was noted."""
        return bool(self._found)

    def refuse(self) -> None:
        """Raise TableError if a mistake was noted."""
        if self._found:
            raise TableError(self._path, list(self._found))
