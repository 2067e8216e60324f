"""Limits of readers, checked against the declared size of a file before memory is allocated for it.

A Parquet file of a megabyte can expand to gigabytes: runs of equal values and dictionaries are stored once. Its footer
states rows and columns, so that the memory for reading is known beforehand. A CSV file cannot expand like that; its
size decides.

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

from drivers.rig_file import refuse_irregular
from hil.files.arrow import look_for_pandas

if TYPE_CHECKING:
    import pyarrow as pa

CEILING = 2 * 10**9
"""Bytes: 40 h at 10 Hz in 60 columns of 8 bytes are 0.7 GB, held `COPIES` times."""
SHARE = 0.25
"""Share of the free memory: a run, its calibrators and a diagnosis work at the same time."""
COPIES = 3
"""Times that the values of a record are held at once: as read, as numbers, and put in the order of time."""
TEXT_COPIES = 6
"""Times that the bytes of a CSV are held at once: as read, as text, as cells, trimmed, in lower case, as numbers."""
MOST_COLUMNS = 4096
"""Most columns of a record. A large rig has some hundred points; the time to distinguish names grows with the
square."""
MOST_JSON = 64 * 10**6
"""Most bytes of a JSON document. A `run.json` or `diagnosis.json` has some ten thousand, a journal entry fewer."""
_UNITS = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9}
_CGROUPS = (
    (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")),
    (Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"), Path("/sys/fs/cgroup/memory/memory.usage_in_bytes")),
)
Failure = Callable[[str], Exception]
"""Exception of the calling reader, made of one sentence."""


def limit_bytes(failure: Failure = ValueError) -> int:
    """Return the most memory for reading one file, bytes.

    Raises
    ------
    failure
        HIL_READ_LIMIT is no size.
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

    Parameters
    ----------
    failure
        Exception to raise.
    copies
        Times that its bytes are held in memory.
    most
        Another limit, bytes.

    Raises
    ------
    failure
        The file is too large, or no regular one. OSError: its status cannot be read.
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


def require_columns(path: Path | str, count: int, failure: Failure) -> None:
    """Check the number of columns of a record; raises `failure`, whose sentence begins with `path`."""
    most = _most_columns(failure)
    if count > most:
        raise failure(
            f"{path} has {count} columns, and at most {most} are read; leave out those that nobody needs, or set "
            "HIL_COLUMN_LIMIT to a larger number"
        )


def require_cells(path: Path, rows: int, columns: int, failure: Failure) -> None:
    """Check that a table from a list of readings stays within the limit; raises `failure`.

    A list of n readings expands to up to n * columns cells: every series has a cell at every time.
    """
    needed, limit = TEXT_COPIES * rows * columns * 8, limit_bytes(failure)
    if needed > limit:
        raise _too_large(path, f"{rows} times of {columns} columns", needed, limit, failure)


def read_parquet(path: Path, source: Any, failure: Failure) -> pa.Table:
    """Return the table of a Parquet file within the limits, without columns of lists.

    The footer is not queried for single columns of a row group: pyarrow 26 ends the process at damaged statistics of
    sizes, and refuses such a file when it is read. A column of lists holds no signal, and the footer does not state its
    number of values.

    Parameters
    ----------
    path
        Name for messages.
    source
        Path or Arrow file to read from.
    failure
        Exception to raise.

    Raises
    ------
    failure
        The declared size, or the size of the unpacked texts, exceeds the limit.
    pyarrow.ArrowException, OSError
        The file is damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    look_for_pandas()
    file = pq.ParquetFile(source)
    about = file.metadata
    require_columns(path, about.num_columns, failure)
    limit = limit_bytes(failure)
    needed = sum(_declared(about, group) for group in range(about.num_row_groups))
    if needed > limit:
        shape = f"{about.num_rows} rows of {about.num_columns} columns"
        raise _too_large(path, shape, needed, limit, failure)
    # Texts of a dictionary are stored once for any number of rows: they are read as stored, and unpacked only where
    # the result fits.
    # `ParquetFile` reads columns of one name, which `read_table` refuses.
    texts = [about.schema.column(i).path for i in range(about.num_columns) if _is_text(about, i)]
    flat = [about.schema.column(i) for i in range(about.num_columns)]
    nested = any(column.max_repetition_level > 0 for column in flat)
    names = list(dict.fromkeys(column.path for column in flat if not column.max_repetition_level)) if nested else None
    table = pq.ParquetFile(source, read_dictionary=texts).read(columns=names, use_threads=False)
    table.validate(full=True)  # indices beyond a dictionary and text that is no UTF-8 would fail later, or crash
    unpacked = sum(_unpacked(column) for column in table.columns)
    if needed + COPIES * unpacked > limit:
        shape = f"texts of {_size(unpacked)} in {about.num_rows} rows"
        raise _too_large(path, shape, needed + COPIES * unpacked, limit, failure)
    columns = [c.cast(c.type.value_type) if pa.types.is_dictionary(c.type) else c for c in table.columns]
    fields = [f.with_type(c.type) for f, c in zip(table.schema, columns, strict=True)]
    return pa.table(columns, schema=pa.schema(fields, table.schema.metadata))


def _declared(about: Any, group: int) -> int:
    """Return the memory of a row group by the footer, bytes."""
    declared = about.row_group(group)
    widths = sum(max(8, about.schema.column(index).length) for index in range(about.num_columns))
    return int(COPIES * max(declared.num_rows, 0) * widths + max(declared.total_byte_size, 0))


def _is_text(about: Any, index: int) -> bool:
    return str(about.schema.column(index).physical_type) == "BYTE_ARRAY"


def _unpacked(column: pa.ChunkedArray) -> int:
    """Return the bytes of a column's texts after unpacking."""
    import pyarrow as pa
    import pyarrow.compute as pc

    total = 0
    for chunk in column.chunks:
        if pa.types.is_dictionary(chunk.type):
            lengths = pc.cast(pc.binary_length(chunk.dictionary), pa.int64())
            total += pc.sum(pc.take(lengths, chunk.indices)).as_py() or 0
    return total


def _free_bytes() -> int:
    """Return the memory that is free without swapping, bytes: of the machine or of the control group, if that is
    less."""
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
    "CEILING",
    "COPIES",
    "MOST_COLUMNS",
    "MOST_JSON",
    "SHARE",
    "TEXT_COPIES",
    "limit_bytes",
    "read_parquet",
    "require_cells",
    "require_columns",
    "require_size",
]
