"""Historian in Parquet files: a folder of them, each with the columns timestamp, tag, value and quality."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from drivers.historian.arrow import PER_SECOND, refuse_other_types, samples_by_tag, table_of
from drivers.historian.parts import Parts, superseded
from drivers.historian.protocol import COLUMNS, HistorianError, HistorianFailedError, Samples, empty
from drivers.historian.write_errors import why_unwritten

_MAGIC = b"PAR1"
"""First bytes of every Parquet file."""


class ParquetStore:
    """A folder of Parquet files, or one file. A time without zone is UTC; other columns and files are left alone.

    A file that begins as a Parquet file and cannot be read is damaged, and no other one: it may hold samples.
    """

    def __init__(self, path: Path, *, create: bool = False) -> None:
        self.path = path
        if not path.exists():
            if not create:
                raise HistorianError(f"{path}: there is no historian; check the path")
            try:
                path.mkdir(parents=True)
            except OSError as error:
                raise HistorianFailedError(f"{path}: the folder cannot be made: {why_unwritten(error)}") from error
        self._parts = Parts(path) if create and path.is_dir() else None
        files = self._files()
        if not files and not create:
            raise HistorianError(f"{path}: no Parquet file here has the columns {', '.join(COLUMNS)}; {self._seen()}")

    @property
    def zoned(self) -> bool | None:
        """True where the time stamps carry a zone of their own, False where none does, None where some do."""
        kinds = {
            getattr(pq.read_schema(path).field("timestamp").type, "tz", None) is not None for path in self._files()
        }
        return None if len(kinds) > 1 else kinds != {False}

    def tags(self) -> tuple[str, ...]:
        names: set[str] = set()
        for _, table in self._tables(("tag",)):
            names.update(name for name in pc.unique(table["tag"]).to_pylist() if name is not None)
        return tuple(sorted(names))

    def span(self) -> tuple[float, float] | None:
        ends = [pc.min_max(table["timestamp"]) for _, table in self._tables(("timestamp",)) if table.num_rows]
        times = [
            end[key].cast(pa.int64()).as_py() / PER_SECOND[end[key].type.unit]
            for end in ends
            for key in ("min", "max")
            if end[key].is_valid
        ]
        return (min(times), max(times)) if times else None

    def read(self, tags: Sequence[str], start_s: float = -np.inf, end_s: float = np.inf) -> dict[str, Samples]:
        pieces: dict[str, list[Samples]] = {tag: [] for tag in tags}
        for path, table in self._tables(COLUMNS):
            try:
                found = samples_by_tag(table, frozenset(tags), start_s, end_s)
            except HistorianError as error:
                raise HistorianError(f"{path}: {error}") from error
            for tag, samples in found.items():
                pieces[tag].append(samples)
        return {tag: _joined(parts) for tag, parts in pieces.items()}

    def append(self, samples: Mapping[str, Samples]) -> None:
        rows = sum(len(one) for one in samples.values())
        if rows == 0:
            return
        if self.path.is_file():
            raise HistorianError(f"{self.path} is a single file and is only read; give a folder to append to")
        if self._parts is None:
            self._parts = Parts(self.path)
        try:
            self._parts.append(table_of(samples))
        except OSError as error:
            raise HistorianFailedError(
                f"{self.path}: {rows} samples could not be written: {why_unwritten(error)}"
            ) from error

    def close(self) -> None:
        pass

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _files(self) -> list[Path]:
        if self.path.is_file():
            return [self.path] if self._columns(self.path) >= set(COLUMNS) else []
        own = set(self.path.glob("*.parquet"))
        found = sorted(own - superseded(own)) + sorted(self.path.glob("*/*.parquet"))
        return [path for path in found if self._columns(path) >= set(COLUMNS)]

    def _columns(self, path: Path) -> set[str]:
        """Return the columns of a file, none of one that only has the ending of a Parquet file."""
        try:
            if not path.is_file():
                return set()
            with path.open("rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    return set()
            return set(pq.read_schema(path).names)
        except (OSError, pa.ArrowException) as error:
            raise HistorianError(
                f"{path}: is damaged and cannot be read ({_reason(error)}); restore it, or take it out of the store"
            ) from error

    def _seen(self) -> str:
        found = [self.path] if self.path.is_file() else sorted(self.path.glob("*.parquet"))
        if not found:
            return "there is no Parquet file"
        return "; ".join(self._lack(path) for path in found[:3])

    def _lack(self, path: Path) -> str:
        columns = self._columns(path)
        if not columns:
            return f"{path.name} is no Parquet file"
        return f"{path.name} lacks {', '.join(sorted(set(COLUMNS) - columns))}"

    def _tables(self, columns: Sequence[str]) -> Iterator[tuple[Path, Any]]:
        """Yield each file with its table, one at a time."""
        for path in self._files():
            try:
                table = pq.ParquetFile(path, read_dictionary=["tag"]).read(columns=list(columns))
            except (OSError, pa.ArrowException) as error:
                raise HistorianError(
                    f"{path}: cannot be read: {_reason(error)}; restore it, or take it out of the store"
                ) from error
            try:
                refuse_other_types(table.schema)
            except HistorianError as error:
                raise HistorianError(f"{path}: {error}") from error
            yield path, table


def _reason(error: BaseException) -> str:
    reason = getattr(error, "strerror", None) or (str(error).splitlines() or ["no reason is given"])[0]
    return str(reason)


def _joined(parts: list[Samples]) -> Samples:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return empty()
    return Samples(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("time_s", "value", "quality"))
    )
