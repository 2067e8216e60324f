"""Historian in Parquet files: a folder of them, each with the columns timestamp, tag, value and quality."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from drivers.historian.arrow import PER_SECOND, samples_by_tag, table_of
from drivers.historian.protocol import COLUMNS, HistorianError, Samples, empty


class ParquetStore:
    """A folder of Parquet files, or one file. A time without zone is UTC; other columns and files are left alone."""

    def __init__(self, path: Path, *, create: bool = False) -> None:
        self.path = path
        self._parts = 0
        if not path.exists():
            if not create:
                raise HistorianError(f"{path}: there is no historian; check the path")
            try:
                path.mkdir(parents=True)
            except OSError as error:
                raise HistorianError(f"{path}: the folder cannot be made: {error.strerror}") from error
        files = self._files()
        if not files and not create:
            raise HistorianError(f"{path}: no Parquet file here has the columns {', '.join(COLUMNS)}; {self._seen()}")

    def tags(self) -> tuple[str, ...]:
        names: set[str] = set()
        for table in self._tables(("tag",)):
            names.update(name for name in pc.unique(table["tag"]).to_pylist() if name is not None)
        return tuple(sorted(names))

    def span(self) -> tuple[float, float] | None:
        ends = [pc.min_max(table["timestamp"]) for table in self._tables(("timestamp",)) if table.num_rows]
        times = [
            end[key].cast(pa.int64()).as_py() / PER_SECOND[end[key].type.unit]
            for end in ends
            for key in ("min", "max")
            if end[key].is_valid
        ]
        return (min(times), max(times)) if times else None

    def read(self, tags: Sequence[str], start_s: float = -np.inf, end_s: float = np.inf) -> dict[str, Samples]:
        pieces: dict[str, list[Samples]] = {tag: [] for tag in tags}
        for table in self._tables(COLUMNS):
            for tag, samples in samples_by_tag(table, frozenset(tags), start_s, end_s).items():
                pieces[tag].append(samples)
        return {tag: _joined(parts) for tag, parts in pieces.items()}

    def append(self, samples: Mapping[str, Samples]) -> None:
        rows = sum(len(one) for one in samples.values())
        if rows == 0:
            return
        if self.path.is_file():
            raise HistorianError(f"{self.path} is a single file and is only read; give a folder to append to")
        table = table_of(samples)
        self._parts += 1
        final = self.path / f"samples-{time.time_ns()}-{os.getpid()}-{self._parts}.parquet"
        unfinished = final.with_suffix(".part")
        try:
            pq.write_table(table, unfinished, compression="zstd")
            unfinished.replace(final)
        except OSError as error:
            unfinished.unlink(missing_ok=True)
            raise HistorianError(
                f"{final}: {rows} samples could not be written: {error.strerror or error}; make room"
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
        found = sorted(self.path.glob("*.parquet")) + sorted(self.path.glob("*/*.parquet"))
        return [path for path in found if self._columns(path) >= set(COLUMNS)]

    def _columns(self, path: Path) -> set[str]:
        try:
            return set(pq.read_schema(path).names)
        except (OSError, pa.ArrowInvalid) as error:
            raise HistorianError(
                f"{path}: is no Parquet file that can be read ({str(error).splitlines()[0]})"
            ) from error

    def _seen(self) -> str:
        found = [self.path] if self.path.is_file() else sorted(self.path.glob("*.parquet"))
        if not found:
            return "there is no Parquet file"
        return "; ".join(
            f"{path.name} lacks {', '.join(sorted(set(COLUMNS) - self._columns(path)))}" for path in found[:3]
        )

    def _tables(self, columns: Sequence[str]) -> list[Any]:
        try:
            return [pq.read_table(path, columns=list(columns), read_dictionary=["tag"]) for path in self._files()]
        except (OSError, pa.ArrowInvalid) as error:
            raise HistorianError(f"{self.path}: cannot be read: {str(error).splitlines()[0]}") from error


def _joined(parts: list[Samples]) -> Samples:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return empty()
    return Samples(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("time_s", "value", "quality"))
    )
