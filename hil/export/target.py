"""Files of an export: chosen names, refusal to overwrite, and writing beside the target with a rename at the end."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from hil.export.content import ExportError
from hil.files import replacing
from hil.run_folder import require_output

EXTRA = "hil-rig[export]"
"""Extra of the package with the libraries of the formats that the harness itself does not need."""

ENDINGS = {
    "csv": (".csv",),
    "parquet": (".parquet", ".pq"),
    "mf4": (".mf4",),
    "hdf5": (".h5", ".hdf5", ".hdf"),
    "tdms": (".tdms",),
    "fmu": (".fmu",),
}
"""Format -> endings of its files, the usual one first."""

Writer = Callable[[BinaryIO], None]
"""Function that writes a whole file into an open one, for reading and writing, and leaves it open."""


def required_library(name: str, purpose: str) -> Any:
    """Import and return the library `name`.

    Raises
    ------
    ExportError
        It is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ExportError(
            f"{purpose} needs {name}, which is not installed; install it with: pip install '{EXTRA}'"
        ) from None


def require_suffix(path: Path, to: str) -> None:
    """Check that the name of a file does not have the ending of another format than `to`, a key of `ENDINGS`.

    Raises
    ------
    ExportError
        It has: other programs choose their reader by the ending.
    """
    ending = path.suffix.lower()
    other = next((name for name, endings in ENDINGS.items() if ending in endings and name != to), None)
    if other is not None:
        raise ExportError(
            f"{path} ends as a file of the format {other}, and --to {to} writes {to}; name it "
            f"{path.with_suffix(ENDINGS[to][0]).name}"
        )


def write_files(writers: Mapping[Path, Writer], replace_existing: bool, sources: Iterable[Path] = ()) -> None:
    """Write several files, each beside its place; all of them are renamed into place once the last is complete.

    Parameters
    ----------
    writers
        Path -> function that writes it.
    replace_existing
        False refuses a path that exists.
    sources
        Files from which the export is made; neither they nor the files of a run are replaced.

    Raises
    ------
    ExportError
        A path exists, or cannot be written. Nothing that was there before has then changed.
    """
    kept = tuple(sources)
    for path in writers:
        require_output(path, ExportError, kept)
        if path.exists() and not replace_existing:
            raise ExportError(f"{path} exists; choose another name with --out, or replace it with --force")
    try:
        with contextlib.ExitStack() as stack:
            for path, write in writers.items():
                with _opened(stack.enter_context(replacing(path))) as file:
                    write(file)
    except OSError as error:
        place = next(iter(writers))
        raise ExportError(
            f"{place} cannot be written ({error.strerror or error}); nothing was left there. Free some room, or choose "
            "another place with --out"
        ) from error


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    with path.open("w+b") as file:
        yield file
