"""Store of samples in CSV files, as a historian exports them, behind the protocol of `drivers.historian`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from drivers.historian import HistorianError, HistorianStore, Samples, open_store
from hil.record import ReadingOptions, RecordError, read_cells, tag_samples

OTHERS = frozenset({"tags.csv", "events.csv", "labels.csv", "commissioning.csv", "points.csv"})
"""Names of a station's other files."""


class CsvStore:
    """CSV files with samples, read whole and never written. `zoneless`: files whose times have no zone."""

    def __init__(self, files: Sequence[Path], choice: ReadingOptions | None = None) -> None:
        pieces: dict[str, list[Samples]] = {}
        zoneless = []
        for path in files:
            found, without_zone = tag_samples(read_cells(path), choice)
            zoneless += [path] if without_zone else []
            for tag, samples in found.items():
                pieces.setdefault(tag, []).append(samples)
        self._samples = {tag: _joined(parts) for tag, parts in pieces.items()}
        self.zoneless = tuple(zoneless)
        self.zoned: bool | None = None if 0 < len(zoneless) < len(files) else not zoneless

    def tags(self) -> tuple[str, ...]:
        """Return the names of the tags, sorted."""
        return tuple(sorted(self._samples))

    def span(self) -> tuple[float, float] | None:
        """Return the times of the first and the last sample, s since 1970."""
        times = [one.time_s for one in self._samples.values() if len(one)]
        return (min(float(t.min()) for t in times), max(float(t.max()) for t in times)) if times else None

    def read(self, tags: Sequence[str], start_s: float = -np.inf, end_s: float = np.inf) -> dict[str, Samples]:
        """Return the samples of the tags from `start_s` to before `end_s`."""
        none = Samples(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int16))
        found = {tag: self._samples.get(tag, none) for tag in tags}
        return {tag: _rows(one, (one.time_s >= start_s) & (one.time_s < end_s)) for tag, one in found.items()}

    def append(self, samples: Mapping[str, Samples]) -> None:
        """Raise HistorianError: CSV files are only read."""
        raise HistorianError(
            "CSV files are only read; give a folder of Parquet files, DuckDB or PostgreSQL to write to"
        )

    def close(self) -> None:
        """Close nothing: the files were read whole."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_samples(
    address: str,
    others: Iterable[Path] = (),
    *,
    say: Callable[[str], None] | None = None,
    choice: ReadingOptions | None = None,
) -> HistorianStore:
    """Return the store at `address`: CSV files where it is one, or a folder of them without Parquet files.

    Parameters
    ----------
    address
        As `drivers.historian.open_store` takes it, or a CSV file, or a folder.
    others
        Files of the station that hold no samples.
    say
        Takes a sentence on a store that is waited for.
    choice
        Decimal sign, order of dates and time column of CSV files, where they are ambiguous.

    Raises
    ------
    HistorianError
        There is no store, or it cannot be opened.
    RecordError
        A CSV file cannot be read as samples.
    """
    path = Path(address)
    if path.suffix.lower() == ".csv" and path.is_file():
        return CsvStore([path], choice)
    if path.is_dir() and not any(path.glob("*.parquet")) and not any(path.glob("*/*.parquet")):
        apart = {other.resolve() for other in others}
        files = [
            one
            for one in sorted(path.glob("*.csv"))
            if one.name.lower() not in OTHERS and one.resolve() not in apart and one.is_file()
        ]
        if files:
            return CsvStore(files, choice)
        raise RecordError(
            f"{path}: holds no samples; give a folder of Parquet or CSV files with the columns timestamp, tag, value, "
            f"quality, or of CSV files with a column for each tag"
        )
    return open_store(address) if say is None else open_store(address, say=say)


def _joined(parts: Sequence[Samples]) -> Samples:
    if len(parts) == 1:
        return parts[0]
    return Samples(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("time_s", "value", "quality"))
    )


def _rows(samples: Samples, chosen: np.ndarray) -> Samples:
    return Samples(samples.time_s[chosen], samples.value[chosen], samples.quality[chosen])
