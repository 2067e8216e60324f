"""Limits of readers, checked against what a file declares before anything is allocated for it.

A Parquet file of a megabyte can stand for gigabytes: runs of equal values and dictionaries are stored once. Its footer
tells rows and columns, so the memory that reading takes is known beforehand. A CSV file cannot expand like that; there
its size decides.

The limit is a quarter of the memory that is free (of the machine, or of the control group that the process runs in),
and at most `CEILING`. The environment variable HIL_READ_LIMIT sets another one, in bytes, with K, M or G behind the
number for powers of 1000; HIL_COLUMN_LIMIT sets another number of columns.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.rig_file.regular_file import refuse_irregular

if TYPE_CHECKING:
    import pyarrow as pa

CEILING = 2 * 10**9
"""Bytes: 40 h at 10 Hz in 60 columns of 8 bytes are 0.7 GB, held `COPIES` times."""
SHARE = 0.25
"""Of the memory that is free: a run, its calibrators and a diagnosis work beside a reader."""
COPIES = 3
"""Times that the values of a record are held at once: as read, as numbers, and put in the order of time."""
TEXT_COPIES = 6
"""Times that the bytes of a CSV are held at once: as read, as text, as cells, trimmed, in lower case, as numbers."""
MOST_COLUMNS = 4096
"""Columns of a record. A large rig has some hundred points; the time to tell names apart grows with the square."""
MOST_JSON = 64 * 10**6
"""Bytes of a JSON document. A `run.json` or `diagnosis.json` has some ten thousand, a journal entry fewer."""
_UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9}
_CGROUPS = (
    (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")),
    (Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"), Path("/sys/fs/cgroup/memory/memory.usage_in_bytes")),
)
Failure = Callable[[str], Exception]
"""The exception of the reader that asks, made of one sentence."""


def limit_bytes(failure: Failure = ValueError) -> int:
    """Return how many bytes reading one file may take.

    Raises:
        failure: HIL_READ_LIMIT is no size.
    """
    given = os.environ.get("HIL_READ_LIMIT", "").strip()
    if not given:
        return int(min(CEILING, SHARE * _free_bytes()))
    found = re.fullmatch(r"(\d{1,15})\s*([KMG]?)B?", given, re.IGNORECASE)
    if not found:
        raise failure(f"HIL_READ_LIMIT is {given!r}, which is no size; write bytes, or for example 4G")
    return int(found.group(1)) * _UNITS[found.group(2).upper()]


def require_size(path: Path, failure: Failure, copies: int = TEXT_COPIES, most: int | None = None) -> None:
    """Check that a file is a regular one and that reading it stays within the limit.

    Args:
        failure: what to raise, of one sentence. copies: times that its bytes are held. most: another limit, bytes.

    Raises:
        failure: it is too large, or no file that ends. OSError: it cannot be looked at.
    """
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        try:
            refuse_irregular(path, status.st_mode)
        except OSError as error:
            raise failure(f"{path} is no regular file ({error.strerror}); give a file") from None
        raise failure(f"{path} is no regular file; give a file")
    limit = limit_bytes(failure) if most is None else most
    if status.st_size * copies > limit:
        raise _too_large(path, f"{_size(status.st_size)}", status.st_size * copies, limit, failure)


def require_columns(path: Path, count: int, failure: Failure) -> None:
    """Check the number of columns of a record; raises `failure`."""
    most = _most_columns(failure)
    if count > most:
        raise failure(
            f"{path} has {count} columns, and at most {most} are read; leave out those that nobody needs, or set "
            "HIL_COLUMN_LIMIT to a larger number"
        )


def require_cells(path: Path, rows: int, columns: int, failure: Failure) -> None:
    """Check that a table spread from a list of readings stays within the limit; raises `failure`.

    A list of n readings stands for up to n * columns cells: every series has a cell at every time.
    """
    needed, limit = TEXT_COPIES * rows * columns * 8, limit_bytes(failure)
    if needed > limit:
        raise _too_large(path, f"{rows} times of {columns} columns", needed, limit, failure)


def read_parquet(path: Path, source: Any, failure: Failure) -> pa.Table:
    """Return the table of a Parquet file that stays within the limits when it is read.

    Args:
        path: names it in messages. source: path or Arrow file to read from.

    Raises:
        failure: it declares, or its texts unpack to, more than the limit. pyarrow.ArrowException, OSError: it is
            damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(source)
    about = file.metadata
    require_columns(path, about.num_columns, failure)
    limit = limit_bytes(failure)
    needed = sum(_declared(about, group) for group in range(about.num_row_groups))
    if needed > limit:
        shape = f"{about.num_rows} rows of {about.num_columns} columns"
        raise _too_large(path, shape, needed, limit, failure)
    # Texts of a dictionary are stored once and may stand for any number of rows: they are read as they are stored,
    # and unpacked only where the result is known to fit.
    # `ParquetFile` reads columns of one name, which `read_table` refuses.
    texts = [about.schema.column(i).path for i in range(about.num_columns) if _is_text(about, i)]
    table = pq.ParquetFile(source, read_dictionary=texts).read(use_threads=False)
    table.validate(full=True)  # indices beyond a dictionary and text that is no UTF-8 would fail later, or crash
    unpacked = sum(_unpacked(column) for column in table.columns)
    if needed + COPIES * unpacked > limit:
        shape = f"texts of {_size(unpacked)} in {about.num_rows} rows"
        raise _too_large(path, shape, needed + COPIES * unpacked, limit, failure)
    columns = [c.cast(c.type.value_type) if pa.types.is_dictionary(c.type) else c for c in table.columns]
    fields = [f.with_type(c.type) for f, c in zip(table.schema, columns, strict=True)]
    return pa.table(columns, schema=pa.schema(fields, table.schema.metadata))


def _declared(about: Any, group: int) -> int:
    """Bytes that a row group takes when it is read, by the footer."""
    total = 0
    for index in range(about.num_columns):
        chunk = about.row_group(group).column(index)
        width = max(8, about.schema.column(index).length)
        total += COPIES * max(chunk.num_values, about.row_group(group).num_rows) * width
        total += max(chunk.total_uncompressed_size, 0)
    return total


def _is_text(about: Any, index: int) -> bool:
    return str(about.schema.column(index).physical_type) == "BYTE_ARRAY"


def _unpacked(column: pa.ChunkedArray) -> int:
    """Bytes of a column's texts once every row holds its own."""
    import pyarrow as pa
    import pyarrow.compute as pc

    total = 0
    for chunk in column.chunks:
        if pa.types.is_dictionary(chunk.type):
            lengths = pc.cast(pc.binary_length(chunk.dictionary), pa.int64())
            total += pc.sum(pc.take(lengths, chunk.indices)).as_py() or 0
    return total


def _free_bytes() -> int:
    """Memory that is free without swapping, of the machine or of the control group, whichever is less."""
    free = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        found = re.search(r"MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
        free = int(found.group(1)) * 1024 if found else free
    except OSError:
        pass  # not Linux: all of the memory counts as free
    for most, used in _CGROUPS:
        try:
            free = min(free, max(int(most.read_text()) - int(used.read_text()), 0))
        except (OSError, ValueError):
            continue  # no such group, or "max"
    return free


def _most_columns(failure: Failure) -> int:
    given = os.environ.get("HIL_COLUMN_LIMIT", "").strip()
    if not given:
        return MOST_COLUMNS
    if not given.isdecimal() or len(given) > 9:
        raise failure(f"HIL_COLUMN_LIMIT is {given!r}, which is no number of columns; write for example 10000")
    return int(given)


def _too_large(path: Path, shape: str, needed: int, limit: int, failure: Failure) -> Exception:
    return failure(
        f"{path} has {shape} and would take {_size(needed)} of memory to read, more than the limit of {_size(limit)}; "
        "cut it into parts or leave columns out, or set HIL_READ_LIMIT to a larger size, for example "
        f"{-(-needed // 10**9)}G"
    )


def _size(count: float) -> str:
    for unit in ("bytes", "kB", "MB", "GB"):
        if count < 1000.0 or unit == "GB":
            return f"{count:.0f} bytes" if unit == "bytes" else f"{count:.3g} {unit}"
        count /= 1000.0
    raise AssertionError


__all__ = [
    "CEILING", "COPIES", "MOST_COLUMNS", "MOST_JSON", "SHARE", "TEXT_COPIES", "limit_bytes", "read_parquet",
    "require_cells", "require_columns", "require_size",
]  # fmt: skip
