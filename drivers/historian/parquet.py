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

from drivers.historian.protocol import COLUMNS, HistorianError, Samples, empty

SCHEMA = pa.schema(
    [("timestamp", pa.timestamp("ms", tz="UTC")), ("tag", pa.dictionary(pa.int32(), pa.string())), ("value", pa.float64()),
     ("quality", pa.int16())]
)  # fmt: skip


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
        times = [end[key].cast(pa.int64()).as_py() / _per_second(end[key].type) for end in ends for key in ("min", "max") if end[key].is_valid]
        return (min(times), max(times)) if times else None

    def read(self, tags: Sequence[str], start_s: float = -np.inf, end_s: float = np.inf) -> dict[str, Samples]:
        pieces: dict[str, list[Samples]] = {tag: [] for tag in tags}
        for table in self._tables(COLUMNS):
            for tag, samples in _by_tag(table, frozenset(tags), start_s, end_s).items():
                pieces[tag].append(samples)
        return {tag: _joined(parts) for tag, parts in pieces.items()}

    def append(self, samples: Mapping[str, Samples]) -> None:
        rows = sum(len(one) for one in samples.values())
        if rows == 0:
            return
        if self.path.is_file():
            raise HistorianError(f"{self.path} is a single file and is only read; give a folder to append to")
        names = list(samples)
        index = np.repeat(np.arange(len(names), dtype=np.int32), [len(samples[name]) for name in names])
        time_s = np.concatenate([samples[name].time_s for name in names])
        table = pa.table(
            [
                pa.array(np.round(time_s * 1e3).astype("datetime64[ms]"), pa.timestamp("ms", tz="UTC")),
                pa.DictionaryArray.from_arrays(pa.array(index), pa.array(names, pa.string())),
                pa.array(np.concatenate([samples[name].value for name in names]), pa.float64()),
                pa.array(np.concatenate([samples[name].quality for name in names]), pa.int16()),
            ],
            schema=SCHEMA,
        )
        self._parts += 1
        final = self.path / f"samples-{time.time_ns()}-{os.getpid()}-{self._parts}.parquet"
        unfinished = final.with_suffix(".part")
        try:
            pq.write_table(table, unfinished, compression="zstd")
            unfinished.replace(final)
        except OSError as error:
            unfinished.unlink(missing_ok=True)
            raise HistorianError(f"{final}: {rows} samples could not be written: {error.strerror or error}; make room") from error

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
            raise HistorianError(f"{path}: is no Parquet file that can be read ({str(error).splitlines()[0]})") from error

    def _seen(self) -> str:
        found = [self.path] if self.path.is_file() else sorted(self.path.glob("*.parquet"))
        if not found:
            return "there is no Parquet file"
        return "; ".join(f"{path.name} lacks {', '.join(sorted(set(COLUMNS) - self._columns(path)))}" for path in found[:3])

    def _tables(self, columns: Sequence[str]) -> list[Any]:
        try:
            return [pq.read_table(path, columns=list(columns), read_dictionary=["tag"]) for path in self._files()]
        except (OSError, pa.ArrowInvalid) as error:
            raise HistorianError(f"{self.path}: cannot be read: {str(error).splitlines()[0]}") from error


def _by_tag(table: Any, wanted: frozenset[str], start_s: float, end_s: float) -> dict[str, Samples]:
    """Return the samples of a file by tag, in their order within the file."""
    stamp = table["timestamp"]
    if not pa.types.is_timestamp(stamp.type):
        raise HistorianError(f"column timestamp holds {stamp.type} and no times; store timestamps with a zone")
    time_s = stamp.cast(pa.int64()).to_numpy() / _per_second(stamp.type)
    value = table["value"].cast(pa.float64()).to_numpy()
    quality = pc.fill_null(table["quality"].cast(pa.int16()), 0).to_numpy()
    coded = table["tag"].combine_chunks()
    if not pa.types.is_dictionary(coded.type):
        coded = pc.dictionary_encode(coded)
    if isinstance(coded, pa.ChunkedArray):
        coded = coded.unify_dictionaries().combine_chunks()
    names = coded.dictionary.to_pylist()
    code = pc.fill_null(coded.indices, -1).to_numpy()
    order = np.argsort(code, kind="stable")
    begin = np.searchsorted(code[order], np.arange(len(names)), side="left")
    end = np.searchsorted(code[order], np.arange(len(names)), side="right")
    found = {}
    for k, name in enumerate(names):
        if name not in wanted or begin[k] == end[k]:
            continue
        rows = order[begin[k] : end[k]]
        if np.isfinite(start_s) or np.isfinite(end_s):
            rows = rows[(time_s[rows] >= start_s) & (time_s[rows] < end_s)]
        found[name] = Samples(time_s[rows], value[rows], quality[rows])
    return found


def _per_second(kind: Any) -> float:
    return float({"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[kind.unit])


def _joined(parts: list[Samples]) -> Samples:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return empty()
    return Samples(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("time_s", "value", "quality")))
