"""Results of a diagnosis as files: document, curves and page, with the provenance of its inputs."""

from __future__ import annotations

import contextlib
import datetime
import platform
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from drivers.rig_file import file_sha256
from hil import __version__
from hil.diagnosis.store import (
    CURVES,
    DOCUMENT,
    EXPERIMENT,
    PAGE,
    PROPOSAL,
    REVIEW,
    STAGED,
    curves_of,
    write_curves,
    write_document,
)
from hil.files import parse_json
from twin.discovery import Diagnosis


def provenance(
    files: dict[str, Path | None],
    samples_sha256: str | None,
    options: Sequence[str] = (),
    named: Callable[[Path], str] = str,
) -> dict[str, object]:
    """Return the hash of each file, versions, host and time.

    Parameters
    ----------
    files
        Files by their names in the document.
    samples_sha256
        Digest of the samples that were diagnosed (`hil.journal.samples_sha256`); None for a record of other origin.
    options
        Options of the command that change what the diagnosis can find.
    named
        Function that returns the path of a file in the document.
    """
    return {
        "files": {
            name: {"path": named(path), "sha256": file_sha256(path)} for name, path in files.items() if path is not None
        },
        "samples_sha256": samples_sha256,
        "options": list(options),
        "versions": {
            "hil": __version__,
            "python": platform.python_version(),
            **{name: metadata.version(name) for name in ("numpy", "scipy", "llvmlite", "pyarrow", "matplotlib")},
        },
        "made": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
    }


@contextlib.contextmanager
def whole_results(out: Path, extra: Mapping[str, Any]) -> Iterator[Path]:
    """Give a folder for the results of a diagnosis, which go to `out` when the block has ended, the document last.

    So a process that is stopped in the block leaves nothing in `out`. Its folder begins with `STAGED`.
    """
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=STAGED) as name:
        yield Path(name)
        _keep_other(out, extra)
        out.mkdir(parents=True, exist_ok=True)
        for file in sorted(Path(name).iterdir(), key=lambda file: file.name == DOCUMENT):
            file.replace(out / file.name)


def write(diagnosis: Diagnosis, sensors: tuple[str, ...], out: Path, extra: dict[str, object]) -> Path:
    """Write document, curves and page into the folder; return the page. `sensors` are the twin's.

    A diagnosis that was made there of another record or with another twin is kept in a folder below, `before-1` and
    so on.
    """
    from hil.diagnosis.page import write_page

    write_data(diagnosis, sensors, out, extra)
    return write_page(out)


def write_data(diagnosis: Diagnosis, sensors: tuple[str, ...], out: Path, extra: dict[str, object]) -> None:
    """Write document and curves as `write` does, without the page."""
    _keep_other(out, extra)
    out.mkdir(parents=True, exist_ok=True)
    write_document({**diagnosis.document(), **extra}, out)
    write_curves(curves_of(diagnosis, sensors), out / CURVES)


def _keep_other(folder: Path, extra: Mapping[str, Any]) -> None:
    """Move the files of a diagnosis of other inputs out of the way."""
    try:
        there = parse_json((folder / DOCUMENT).read_bytes())
    except (OSError, ValueError):
        return
    if _sha256(there, "twin") is None or _is_same(there, extra):
        return
    number = 1
    while (kept := folder / f"before-{number}").exists():
        number += 1
    kept.mkdir()
    for name in (DOCUMENT, CURVES, PAGE, REVIEW, EXPERIMENT, PROPOSAL):
        if (folder / name).is_file():
            (folder / name).rename(kept / name)


def _is_same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return True for diagnoses of one twin and one record.

    The record of a run that goes on has no checksum in its diagnosis: its path counts.
    """
    if _sha256(one, "twin") != _sha256(other, "twin"):
        return False
    records = _sha256(one, "record"), _sha256(other, "record")
    return one.get("record") == other.get("record") if None in records else records[0] == records[1]


def _sha256(document: Mapping[str, Any], file: str) -> str | None:
    """Return the SHA-256 of a file of a diagnosis, None where it does not say."""
    try:
        return str(document["provenance"]["files"][file]["sha256"])
    except (KeyError, TypeError):
        return None
