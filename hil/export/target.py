"""Files of an export: chosen names, refusal to overwrite, and writing beside the target with a rename at the end."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from hil.export.content import ExportError
from hil.files import replacing

EXTRA = "hil-rig[export]"
"""Extra of the package with the libraries of the formats that the harness itself does not need."""

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


def write_files(writers: Mapping[Path, Writer], replace_existing: bool, sources: Iterable[Path] = ()) -> None:
    """Write several files, each beside its place; all of them are renamed into place once the last is complete.

    Parameters
    ----------
    writers
        Path -> function that writes it.
    replace_existing
        False refuses a path that exists.
    sources
        Files that are never replaced: the ones from which the export is made.

    Raises
    ------
    ExportError
        A path exists, or cannot be written. Nothing that was there before has then changed.
    """
    kept = {source.resolve() for source in sources}
    for path in writers:
        if path.resolve() in kept:
            raise ExportError(f"{path} is a file from which the export is made; choose another name with --out")
        if path.is_dir():
            raise ExportError(f"{path} is a folder; name a file with --out")
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
