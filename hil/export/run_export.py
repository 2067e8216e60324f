"""Export of a run as one file in the format that another tool reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import BinaryIO

from hil.export.content import ExportError, RunContent, read_run
from hil.export.measurement_files import write_hdf5, write_mf4, write_tdms
from hil.export.tables import csv_files, write_parquet
from hil.export.target import ENDINGS, Writer, require_suffix, write_files
from hil.run_folder import RunFolder, require_output

SUFFIX = {name: endings[0] for name, endings in ENDINGS.items() if name != "fmu"}
"""Format -> ending of its files."""

_WRITERS: dict[str, Callable[[RunContent, BinaryIO], None]] = {
    "parquet": write_parquet,
    "mf4": write_mf4,
    "hdf5": write_hdf5,
    "tdms": write_tdms,
}
"""Writers of formats that are a single file."""


def export_run(
    run: Path, to: str, out: Path | None = None, *, signals: Iterable[str] = (), force: bool = False
) -> tuple[Path, ...]:
    """Write all recorded signals of a run with units, qualities and events, and return the files.

    Parameters
    ----------
    run
        Run folder with a journal.
    to
        Format, a key of `SUFFIX`.
    out
        File to write; by default the name of the run's folder with the format's ending, in the working directory.
    signals
        Columns, names or patterns of the signals to write; all by default.
    force
        Replace a file that exists.

    Raises
    ------
    ExportError
        There is no journal, no such signal, no library for the format, or the file exists or cannot be written.
    JournalError, RunFolderError
        The run cannot be read.
    """
    if to not in SUFFIX:
        raise ExportError(f"a run is exported to {', '.join(SUFFIX)}, not to {to!r}")
    path = out or Path(run.resolve().name + SUFFIX[to])
    require_suffix(path, to)
    require_output(path, ExportError)
    content = read_run(run)
    if names := tuple(signals):
        content = content.chosen(names)
    files: dict[Path, Writer] = {path: lambda file: _WRITERS[to](content, file)}
    if to == "csv":
        files = csv_files(content, path)
    write_files(files, force, (RunFolder(run).journal,))
    return tuple(files)
