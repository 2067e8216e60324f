"""Files that one store appends to its folder, and their mergers.

A store appends a file at a time. When `TOGETHER` of one size class are there, they are merged into one file of the next
class, so that a year of minutes is some hundred files. Names tell which appends a file has: `samples-RUN-PID-FROM` has
one, `samples-RUN-PID-FROM-UPTO` all of them. A file whose appends another one has as well is superseded, and readers
leave it out. It is deleted at the next merger, or when a store is next opened to append: whoever has listed it can read
it until then. After a crash at any moment each sample is in exactly one file that counts.
"""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

TOGETHER = 32
"""Files of one size class that are merged: a file is written again once for each class, so few are enough."""
MOST_ROWS = 4_000_000
"""Rows beyond which a file is merged no further (some 100 MB of memory)."""
_NAME = re.compile(r"samples-(\d+)-(\d+)-(\d+)(?:-(\d+))?\.parquet")


@dataclass(frozen=True, slots=True)
class _Part:
    """File of the appends `first` to `last` of one opened store."""

    path: Path
    run: tuple[str, str]
    first: int
    last: int

    def is_in(self, other: _Part) -> bool:
        """Return True where `other` is a larger file that has all appends of this one."""
        wider = other.last - other.first > self.last - self.first
        return wider and self.run == other.run and other.first <= self.first and self.last <= other.last


def _part(path: Path) -> _Part | None:
    found = _NAME.fullmatch(path.name)
    if found is None:
        return None
    run, pid, first, last = found.groups()
    return _Part(path, (run, pid), int(first), int(last or first))


def superseded(files: Iterable[Path]) -> set[Path]:
    """Return those of the files of one folder whose samples another one has as well."""
    parts = [part for part in map(_part, files) if part is not None]
    merged: dict[tuple[str, str], list[_Part]] = {}
    for part in parts:
        if part.last > part.first:
            merged.setdefault(part.run, []).append(part)
    return {part.path for part in parts if any(part.is_in(other) for other in merged.get(part.run, ()))}


class Parts:
    """Files that a store appends to `folder`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._run = (str(time.time_ns()), str(os.getpid()))
        self._count = 0
        self._classes: list[list[tuple[_Part, int]]] = [[]]
        """Files and their rows, by size class."""
        self._delete(superseded(folder.glob("samples-*.parquet")))

    def append(self, table: pa.Table) -> None:
        """Write a file with a table's rows, and merge files where enough of a size class are there.

        Raises
        ------
        OSError
            The file cannot be written. A merger that cannot be written is tried again at the next append.
        """
        self._count += 1
        part = self._named(self._count, self._count)
        _write(table, part.path)
        self._classes[0].append((part, table.num_rows))
        with contextlib.suppress(OSError, pa.ArrowException):
            self._merge()

    def _merge(self) -> None:
        for k, files in enumerate(self._classes):
            rows = sum(count for _, count in files)
            if len(files) < TOGETHER or rows > MOST_ROWS:
                continue
            self._delete(superseded(self.folder.glob("samples-*.parquet")))
            merged = self._named(files[0][0].first, files[-1][0].last)
            _write(pa.concat_tables([pq.ParquetFile(part.path).read() for part, _ in files]), merged.path)
            self._classes[k] = []
            if k + 1 == len(self._classes):
                self._classes.append([])
            self._classes[k + 1].append((merged, rows))
            return

    def _named(self, first: int, last: int) -> _Part:
        upto = f"-{last:08d}" if last > first else ""
        name = f"samples-{self._run[0]}-{self._run[1]}-{first:08d}{upto}.parquet"
        return _Part(self.folder / name, self._run, first, last)

    @staticmethod
    def _delete(files: Iterable[Path]) -> None:
        for path in files:
            with contextlib.suppress(OSError):
                path.unlink()


def _write(table: pa.Table, path: Path) -> None:
    """Write a file whole, or not at all, also where the power fails."""
    unfinished = path.with_suffix(".part")
    try:
        pq.write_table(table, unfinished, compression="zstd")
        with unfinished.open("rb") as file:
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
